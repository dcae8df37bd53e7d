"""`SimWorld`: MuJoCo physics of a planning scene, advanced only by explicit calls."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from armcell.core import SE3, InputError, JointState, StateSample, UnknownNameError
from armcell.core.checks import float_array
from armcell.core.joints import all_finite
from armcell.kinematics import kinematic_tree
from armcell.model.mjcf.spec import log_mujoco_warnings
from armcell.scene import PlanningScene
from armcell.sim.camera import Camera
from armcell.sim.contacts import ContactMonitor, hand_wrench
from armcell.sim.decals import Decal
from armcell.sim.gripper_servos import GripperState, gripper_state
from armcell.sim.model_pool import lease_model
from armcell.sim.mujoco_model import BuiltModel, relative_pose, same_build, scene_objects
from armcell.sim.objects import Array, Poses, write_free
from armcell.sim.servo import JointTargets
from armcell.sim.settings import PhysicsSettings
from armcell.sim.stepper import Stepper
from armcell.sim.welds import WeldEvent
from armcell.sim.world_state import Closed, WorldState

log = logging.getLogger(__name__)

BLOCKED = 1e5  # [Nm s/rad or N s/m] damping of a blocked joint: 300 Nm turn it at 0.2 deg/s
_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)


@dataclass(frozen=True, eq=False)
class WorldSnapshot:
    """Full state and records of a `SimWorld` at one time.
    Only the world that created the snapshot can restore it.

    It contains all data that the next step depends on, and all that the world has recorded.
    """

    built: BuiltModel
    physics: Array
    equalities: tuple[Array, Array]
    fixed: Poses
    stepper: tuple
    watches: dict


class SimWorld(WorldState):
    """Simulated world: the physics of one planning scene in MuJoCo. All poses are in the world frame.

    The world frame is the frame of the robot's root link. The simulation is deterministic and advances only
    by `step` and `follow`: the same calls give the same bits.

    Attributes:
        robot: the scene's `RobotModel`.
        monitor: records unwanted contacts at every physics step; `reset` replaces it.
        lock: held while the world takes steps; a thread that reads the state while another thread steps must
            hold it.
        cameras: cameras by name.
        decals: images on links and objects that only cameras see.
        rng: seeded random generator for the noise of this world's sensors; physics does not use it.
        mj_model, mj_data: MuJoCo's model and data, for viewers; do not step them.
    """

    def __init__(
        self,
        scene: PlanningScene,
        settings: PhysicsSettings | None = None,
        cameras: Iterable[Camera] = (),
        seed: int = 0,
        decals: Iterable[Decal] = (),
    ):
        self.settings = settings or PhysicsSettings()
        self.decals = tuple(decals)
        self.cameras = {camera.name: camera for camera in cameras}
        self.seed = seed
        super().__init__()
        self._build(scene)
        self.reset()

    def _build(self, scene: PlanningScene) -> None:
        log_mujoco_warnings()
        self._open(lease_model(scene, self.settings))  # drops an earlier lease, which snapshots may need
        self._tree = kinematic_tree(scene.model)
        self._stepper = Stepper(self.built, self.settings, self._data)
        self._driven = {j: n for n, g in self.built.grippers.items() for j in g.gripper.joint_names}
        self._columns: dict[tuple[str, ...], Any] = {}
        self.render_cache: Any = None  # used by render.py: copy of the scene with visual meshes

    def close(self) -> None:
        """Close the simulated world and return its compiled model to the model pool.

        Closing is optional, but lets the next world of such a scene reuse the memory.
        """
        with self.lock:
            self._stepper = cast(Any, Closed())
            super().close()

    def reset(self, scene: PlanningScene | None = None) -> None:
        """Reset the simulated world to a planning scene: time 0, at rest, and without records.

        A scene that differs from the last one only in joint positions and poses of movable objects is not
        recompiled.

        Args:
            scene: the initial state; by default the last scene.
        """
        if scene is not None:
            if same_build(self.built.scene, scene):
                self.built = replace(self.built, scene=scene, objects=scene_objects(scene))
            else:
                self._build(scene)
        built, data = self.built, self.mj_data
        self._fixed.reset()
        mujoco.mj_resetData(self.mj_model, data)
        self.rng = np.random.default_rng(self.seed)
        self._stepper.reset(built)
        self._watches: dict[str, tuple[str, SE3]] = {}
        for name, start in built.object_qpos.items():
            write_free(data, start, built.objects[name].T_world_object)
        self.set_positions(built.scene.positions)

    @property
    def monitor(self) -> ContactMonitor:
        """Return the contact monitor of the simulated world, which records unwanted contacts at every physics
        step.
        """
        return self._stepper.monitor

    # --- time ---
    @property
    def timestep(self) -> float:
        return float(self.settings.timestep)

    def step(self, n: int = 1) -> None:
        """Take n physics steps.

        Raises:
            InputError: `n` is not an integer below 2^31.
            ArmcellError: the simulation diverged (the state is not finite).
        """
        if not (isinstance(n, int | np.integer) and n < 2**31):
            raise InputError(f"the number of steps is {n!r}, it must be a whole number below 2^31")
        with self.lock:
            self._stepper.take(n)
            self._behind = True
        self.check()

    def check(self) -> None:
        """Raise an ArmcellError if the simulated world has diverged (its state is not finite)."""
        self._stepper.check()

    def follow(
        self, joint_names: Sequence[str], targets: JointTargets, until: float, tolerance: float
    ) -> tuple[float, int]:
        """Track joint targets in the simulated world until a given time or
        until a joint deviates by more than the tolerance.

        Equivalent to calling `set_arm_target` and `step` alternately, with less overhead. The world advances
        by at least one tick.

        Args:
            joint_names: joints of the targets.
            targets: source of the positions and velocities.
            until: time [s] at which to stop.
            tolerance: largest tracking error [rad or m].
        Returns:
            The largest tracking error [rad or m], and the index of its joint in `joint_names`.
        """
        names, data = tuple(joint_names), self._data
        _, controls, fingers, at = self._split(names)
        rows = targets.between(data.time, until)
        positions, velocities = rows[:, : len(names)], rows[:, len(names) :]
        with self.lock:
            followed = None if fingers else self._stepper.follow(rows, targets.steps, tolerance, controls, at)
            if followed is not None:
                used, errors = followed
                self._stepper.servo.command(data, controls, positions[used - 1], velocities[used - 1])
                self._behind = True
        if followed is not None:
            self.check()
        else:
            errors = np.zeros(len(names))
            for q, v in zip(positions, velocities, strict=True):
                self.set_arm_target(names, q, v)
                self.step(targets.steps)
                errors = np.maximum(errors, np.abs(data.qpos[at] - q))
                if errors.max() > tolerance:
                    break
        worst = int(errors.argmax())
        return errors.item(worst), worst

    # --- robot ---
    def set_arm_target(
        self, joint_names: Sequence[str], positions: ArrayLike, velocities: ArrayLike | None = None
    ) -> None:
        """Set target positions [rad or m] and velocities of robot joints in the simulated world.

        A gripper's driven joint moves to its target at the gripper's full force.

        Raises:
            UnknownNameError: a name is not an actuated joint.
            InputError: an array has the wrong length or a value that is not finite.
        """
        names = tuple(joint_names)
        arm, controls, fingers, _ = self._split(names)
        q = float_array(positions, None, "positions", finite=False)
        v = np.zeros(len(names)) if velocities is None else float_array(velocities, None, "velocities", False)
        if q.shape != (len(names),) or v.shape != q.shape:
            raise InputError(f"target of {len(names)} joints has shapes {q.shape} and {v.shape}")
        if not (all_finite(q) and all_finite(v)):
            raise InputError(f"target of joints {', '.join(names)} is not finite")
        if fingers:
            q, v, whole = q[arm], v[arm], q
        self._stepper.servo.command(self._data, controls, q, v)
        for column, gripper in fingers:
            index = self.built.grippers[gripper]
            self.set_gripper_target(gripper, index.gripper.width(float(whole[column])), index.max_force)

    def set_arm_torque(self, joint_names: Sequence[str], torques: ArrayLike) -> None:
        """Apply torques [Nm or N] to arm joints in the simulated world until their next target.

        The torques are added to the gravity compensation.

        Raises:
            UnknownNameError: a name is not an actuated joint.
            InputError: a torque is not finite, or the physics' `arm_control` is not "torque".
        """
        names = tuple(joint_names)
        _, controls, fingers, _ = self._split(names)
        if fingers:
            raise InputError("torques are for arm joints, not for gripper joints")
        self._stepper.servo.apply(controls, float_array(torques, (len(names),), "torques"))

    def arm_target(self) -> JointState:
        """Return the last target positions and velocities of arm joints in the simulated world."""
        names = tuple(self.robot.joint_names[c] for c in self._stepper.servo.columns)
        return JointState(names, self._stepper.servo.target, self._stepper.servo.speed, time=self.time)

    def _split(self, names: tuple[str, ...]) -> tuple:
        if names not in self._columns:
            columns = self.robot.columns(names)
            arm = [i for i, name in enumerate(names) if name not in self._driven]
            controls = self._stepper.servo.controls([columns[i] for i in arm])
            fingers = [(i, self._driven[n]) for i, n in enumerate(names) if n in self._driven]
            self._columns[names] = arm, controls, fingers, self.built.qpos[columns]
        return self._columns[names]

    def set_gripper_target(self, gripper: str, width: float, force_per_finger: float | None = None) -> None:
        """Drive a gripper in the simulated world to a width with limited force per finger.

        Width 0 grasps: the fingers close until an object blocks them, then press with the given force. A
        width above the current one opens the gripper and releases a weld. Width 0 turns the vacuum of a
        suction gripper on, any larger width off.

        Args:
            gripper: name of the gripper.
            width: target width [m].
            force_per_finger: largest force per finger [N]; by default the gripper's maximum.
        Raises:
            UnknownNameError: the gripper does not exist.
            InputError: the width is not finite, or the force is not a positive finite number.
        """
        index = self._gripper(gripper)
        force = index.max_force if force_per_finger is None else float(force_per_finger)
        if not (np.isfinite(width) and np.isfinite(force) and force > 0):
            raise InputError(f"gripper target of width {width} m and force {force} N is not possible")
        if gripper not in self._stepper.fingers.drives:
            self._stepper.suction.switch(gripper, width <= 0.0, self.mj_data)
            if width > 0.0:
                self._stepper.welder.release(self.mj_data, gripper)
            return
        present = index.gripper.width(index.length(self.mj_data.qpos))
        if width > present + 1e-4:
            self._stepper.welder.release(self.mj_data, gripper)
        self._stepper.fingers.drives[gripper].command(float(width), force)

    def gripper_state(self, gripper: str) -> GripperState:
        """Return a gripper's width, finger force and held object in the simulated world."""
        self._gripper(gripper)
        return gripper_state(self.built, self.mj_data, self._stepper.suction, gripper)

    def gripper_width(self, gripper: str) -> float:
        """Return a gripper's width [m] in the simulated world, like `gripper_state` but much faster."""
        index = self._gripper(gripper)
        if not index.joints:
            return self.gripper_state(gripper).width
        column = self.built.joint_qpos[index.gripper.joint_name]
        return index.gripper.width(self._data.qpos.item(column))

    def wrench(self, gripper: str) -> Array:
        """Return the wrench (6,) on a gripper in the simulated world, in N and Nm.
        The reference point is the tcp.

        The wrench has world axes and includes all contacts of the gripper's links, and the vacuum.
        """
        data, tcp = self.mj_data, self._gripper(gripper).tcp_body
        total = hand_wrench(self.built, data, gripper)
        self._stepper.suction.add_pull(gripper, data, data.xpos[tcp], total)
        return total

    def _gripper(self, name: str):
        if name not in self.built.grippers:
            raise UnknownNameError("gripper", name, self.built.grippers)
        return self.built.grippers[name]

    def set_positions(self, q: ArrayLike) -> None:
        """Place the robot in the simulated world at positions q (dof,) and at rest,
        instead of moving it there.

        The joint targets are set to the positions, too.

        For setup only: the physics does not simulate this motion.
        """
        q = self.robot.check_positions(q, margin=1e-3)
        data, built = self.mj_data, self.built
        for name, value in self._tree.full_positions(q).items():
            data.qpos[built.joint_qpos[name]] = value
            data.qvel[built.joint_dof[name]] = 0.0
        self._stepper.servo.hold(data, q)
        for name in built.grippers:
            self._stepper.welder.release(data, name)
            self._stepper.suction.switch(name, False, data)
        for drive in self._stepper.fingers.drives.values():
            joint = drive.index.gripper.joint_name
            drive.hold(data, float(data.qpos[built.joint_qpos[joint]]))
        data.qacc_warmstart[:] = 0.0
        self._stepper.forget()
        mujoco.mj_forward(self.mj_model, data)

    # --- objects ---
    def set_object_pose(self, name: str, T_world_object: SE3) -> None:
        """Place an object in the simulated world, at rest. A fixed object stays there until a reset.

        For setup only: the physics does not simulate this motion.

        Raises:
            UnknownNameError: the object does not exist or is screwed into another object.
        """
        built = self.built
        if name not in built.objects or name in built.threaded:
            raise UnknownNameError("object", name, set(built.objects) - set(built.threaded))
        with self.lock:
            if name in built.object_qpos:
                write_free(self.mj_data, built.object_qpos[name], T_world_object)
                self.mj_data.qvel[built.object_dof[name] :][:6] = 0.0
            else:
                self._fixed.put(built.body[name], T_world_object)
            self.mj_data.qacc_warmstart[:] = 0.0
            self._stepper.forget()
            mujoco.mj_forward(self.mj_model, self.mj_data)

    # --- the whole ---
    def sample(self) -> StateSample:
        """Return the state of joints, objects and grippers in the simulated world, for observers."""
        grippers = {name: self.gripper_state(name) for name in self.built.grippers}
        return StateSample(
            time=self.time,
            joints=self.joint_state(),
            object_poses=self.object_poses(),
            gripper_width={name: state.width for name, state in grippers.items()},
            gripper_force={name: state.force_per_finger for name, state in grippers.items()},
        )

    # --- faults, and the state of a real robot ---
    def add_load(self, link: str, mass: float) -> None:
        """Add a load [kg] at a link's center of mass in the simulated world. Gravity acts on the load.

        The mass stays after a reset to the same scene.
        """
        self.robot.link(link)
        model, body = self.mj_model, self.built.body[link]
        before = float(model.body_mass[body])
        model.body_gravcomp[body] *= before / (before + mass)
        model.body_mass[body] = before + mass
        mujoco.mj_setConst(model, mujoco.MjData(model))

    def block(self, joint: str) -> None:
        """Block a joint in the simulated world by strong damping, so that no motor torque can move it.

        The joint stays blocked after a reset to the same scene.
        """
        if joint not in self.built.joint_dof:
            raise UnknownNameError("joint", joint, self.built.joint_dof)
        self.mj_model.dof_damping[self.built.joint_dof[joint]] = BLOCKED

    def fix_in_hand(self, item: str, gripper: str) -> None:
        """Weld an object to a gripper in the simulated world at its current relative pose.
        The weld appears in `welds`.

        Raises:
            UnknownNameError: the gripper or the movable object does not exist.
        """
        self._gripper(gripper)
        if item not in self.built.object_qpos:
            raise UnknownNameError("movable object", item, self.built.object_qpos)
        self._stepper.welder.fix(self.mj_data, gripper, item, "held by a real gripper")

    # --- grip ---
    @property
    def welds(self) -> tuple[WeldEvent, ...]:
        """Return all welds of objects to simulated grippers since the last reset of the world.

        In grip mode "friction", only `fix_in_hand` adds welds.
        """
        return tuple(self._stepper.welder.events)

    def watch_slip(self, item: str, gripper: str) -> None:
        """Store the current pose of an object relative to a gripper in the simulated world, as the reference
        from which `slip` measures.
        """
        self._object(item)
        index = self._gripper(gripper)
        self._watches[gripper] = (item, relative_pose(self.mj_data, index.tcp_body, self.built.body[item]))

    def slip(self, gripper: str | None = None) -> tuple[float, float]:
        """Return how far an object has slipped [m] and rotated [rad] in a simulated world's gripper.

        Args:
            gripper: name of the gripper; required only if more than one gripper is watched.
        Raises:
            UnknownNameError: no object is watched in the gripper.
        """
        if gripper is None and len(self._watches) == 1:
            gripper = next(iter(self._watches))
        if gripper is None or gripper not in self._watches:
            raise UnknownNameError("watched gripper", gripper, self._watches)
        item, T_then = self._watches[gripper]
        index = self.built.grippers[gripper]
        return T_then.distance_to(relative_pose(self.mj_data, index.tcp_body, self.built.body[item]))

    # --- time travel ---
    def snapshot(self) -> WorldSnapshot:
        """Return a snapshot of the simulated world: its full state, including targets and records."""
        physics = np.empty(mujoco.mj_stateSize(self.mj_model, _STATE))
        mujoco.mj_getState(self.mj_model, self.mj_data, physics, _STATE)
        return WorldSnapshot(
            built=self.built,
            physics=physics,
            equalities=(self.mj_model.eq_data.copy(), self.mj_model.eq_solref.copy()),
            fixed=self._fixed.get_state(),
            stepper=self._stepper.get_state(),
            watches=dict(self._watches),
        )

    def restore(self, snapshot: WorldSnapshot) -> None:
        """Restore the simulated world from its snapshot.

        Afterwards the same calls give the same bits.

        Raises:
            InputError: the snapshot belongs to another world, or was taken before a reset that compiled
                another model.
        """
        if snapshot.built.mj is not self.mj_model:
            raise InputError("the snapshot is of another world")
        self.built = snapshot.built
        self.mj_model.eq_data[:], self.mj_model.eq_solref[:] = snapshot.equalities
        self._fixed.set_state(snapshot.fixed)
        self._stepper.forget()
        self._stepper.set_state(snapshot.stepper)
        mujoco.mj_setState(self.mj_model, self.mj_data, snapshot.physics, _STATE)
        mujoco.mj_forward(self.mj_model, self.mj_data)  # updates poses, contacts and forces for readers
        mujoco.mj_setState(self.mj_model, self.mj_data, snapshot.physics, _STATE)  # restores the warm start
        self._watches = dict(snapshot.watches)
