"""Grasp trials of a gripper without its arm: close on an object, lift it, and shake it.

The hand stays fixed and its surroundings move: for the contacts, removing the support and pulling at the
object's center of mass is equivalent to lifting and shaking the hand. One compiled model therefore serves all
trials of an object, and MuJoCo's own threads run the trials in parallel without Python in between.
"""

from __future__ import annotations

import copy
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import mujoco
import mujoco.rollout
import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, SO3, Box, Shape
from armcell.core.checks import checked
from armcell.core.geometry import extent
from armcell.kinematics import kinematic_tree
from armcell.model import Gripper, RobotModel, SuctionGripper, hand_alone
from armcell.scene import CollisionObject, PlanningScene, solid_inertia
from armcell.sim.mujoco_model import BuiltModel, build, compiled
from armcell.sim.robot import servo_gains
from armcell.sim.settings import PhysicsSettings
from armcell.sim.suction import Suction

Array = NDArray[np.float64]

SUPPORT, OBJECT = "trial support", "trial object"
SUPPORT_THICK = 0.02  # [m]
EVACUATED = 3.0  # time constants until a cup has its vacuum
SEAL_CHECK = 0.04  # [s] between two checks whether the cups still seal
FREE_GAP = 2e-4  # [m] initial gap between the object and its support
STATE = int(mujoco.mjtState.mjSTATE_FULLPHYSICS)
CONTROL = sum(
    int(getattr(mujoco.mjtState, f"mjSTATE_{n}")) for n in ("CTRL", "XFRC_APPLIED", "MOCAP_POS", "MOCAP_QUAT")
)


@dataclass(frozen=True)
@checked()
class TrialSettings:
    """Settings of a simulated grasp trial: durations and motions of the phases in which a hand without an arm
    closes, settles, lifts, shakes and holds the object.
    """

    timestep: float = 0.004  # [s]
    settle: float = 0.15  # [s] time the fingers press before the support is removed
    lift: float = 0.15  # [s]
    shake: float = 0.7  # [s]
    hold: float = 0.15  # [s]
    acceleration: float = 4.0  # [m/s^2] amplitude of the shaking: along the closing axis, across it, then up
    frequency: float = 4.0  # [Hz] of the shaking
    extra_weight: float = 0.2  # additional load during the lift, as a fraction of the weight
    force_rate: float = 200.0  # [N/s] rate at which the finger force rises


@dataclass(frozen=True, eq=False)
@checked()
class GraspTrial:
    """One simulated grasp trial of a hand without an arm: its pose, opening and force,
    and the properties of the object.
    """

    T_object_tcp: SE3
    opening: float  # [m] gripper width at the start
    width: float  # [m] gripper width at which the pads are expected to touch the object
    force: float  # [N] per finger; a suction gripper pulls with its vacuum
    up: tuple[float, float, float]  # direction away from the support, object frame
    friction: float
    mass: float  # [kg]


@dataclass(frozen=True)
class TrialResult:
    """Result of one grasp trial of a hand without an arm: how the object moved in the hand, and whether it
    fell.
    """

    closing: float  # [m] displacement of the center of mass while the hand closed
    slip: float  # [m] displacement of the object's point between the pads, from the closed hand to the end
    turn: float  # [rad] rotation of the object, from the closed hand to the end
    lost: bool  # the object left the fingers, a cup leaked, or the physics diverged


def run_trials(
    model: RobotModel,
    gripper: Gripper,
    item: CollisionObject,
    trials: Sequence[GraspTrial],
    settings: TrialSettings = TrialSettings(),
    threads: int | None = None,
) -> list[TrialResult]:
    """Simulate grasp trials of one object in parallel, and return one result per trial.

    In each trial, a hand without an arm grasps the object.

    Args:
        threads: largest number of threads; by default one per processor.
    Raises:
        InputError: MuJoCo rejects the hand or the object.
    """
    if not trials:
        return []
    world = _World.of(model, gripper, item, settings)
    models = [world.variant(trial) for trial in trials]
    plans = [world.plan(trial) for trial in trials]
    steps = max(len(p.control) for p in plans)
    control = np.stack(
        [np.vstack([p.control, np.repeat(p.control[-1:], steps - len(p.control), 0)]) for p in plans]
    )
    initial = np.stack([p.initial for p in plans])
    count = min(threads or os.cpu_count() or 1, len(trials))
    datas = [mujoco.MjData(world.mj) for _ in range(count)]
    state, _ = mujoco.rollout.rollout(models, datas, initial, control, control_spec=CONTROL)
    return [world.result(plan, rows) for plan, rows in zip(plans, np.asarray(state), strict=True)]


@dataclass(frozen=True, eq=False)
class _Plan:
    initial: Array  # (state,)
    control: Array  # (steps, ctrl, 6 per body, position and quaternion of the support)
    closed: int  # step at which the hand presses, just before the support is removed
    end: int
    sealed: tuple[int, ...] = ()  # suction cups that seal at the start and must seal to the end


@dataclass(frozen=True, eq=False)
class _World:
    built: BuiltModel
    mj: mujoco.MjModel
    gripper: Gripper
    settings: TrialSettings
    T_root_tcp: SE3
    center: Array  # (3,) center of mass [m, object frame]
    shapes: tuple[tuple[Shape, SE3], ...]
    body: int
    suction: Suction

    @staticmethod
    def of(model: RobotModel, gripper: Gripper, item: CollisionObject, settings: TrialSettings) -> _World:
        hand = _hand(model, gripper)
        thing = replace(item, name=OBJECT, T_world_object=SE3.from_xyz(0, 0, 5.0), movable=True)
        support = CollisionObject.single(SUPPORT, Box(1.0, 1.0, SUPPORT_THICK), SE3.from_xyz(0, 0, -5.0))
        scene = PlanningScene.of(hand, objects=[thing, support])
        built = build(scene, PhysicsSettings(timestep=settings.timestep, gravity=(0.0, 0.0, 0.0)))
        built.spec.body(SUPPORT).mocap = True
        mj = compiled(built.spec)
        tree = kinematic_tree(hand)
        T_root_tcp = tree.link_pose(hand.default_positions(), gripper.tcp_link)
        center, _ = solid_inertia(item.shapes, 1.0)
        suction = Suction(built, settings.timestep, np.zeros((1, len(gripper.contact_links)), np.int64))
        body = mj.body(OBJECT).id
        return _World(built, mj, gripper, settings, T_root_tcp, center, item.shapes, body, suction)

    def variant(self, trial: GraspTrial) -> mujoco.MjModel:
        """Return a copy of the MuJoCo model with the friction, mass and finger force of one grasp trial of a
        hand.
        """
        mj = copy.copy(self.mj)
        scale = trial.mass / float(self.mj.body_mass[self.body])
        mj.body_mass[self.body] *= scale
        mj.body_inertia[self.body] *= scale
        mj.geom_friction[mj.geom_bodyid == self.body, 0] = trial.friction
        index = self.built.grippers[self.gripper.name]
        if not index.joints:
            return mj
        servo = min(trial.force, index.max_force) * abs(self.gripper.width_per_joint)
        actuator = int(np.flatnonzero(mj.actuator_ctrladr == index.ctrl)[0])
        mj.actuator_forcerange[actuator] = [-servo, servo]
        return mj

    def plan(self, trial: GraspTrial) -> _Plan:
        s, mj, index = self.settings, self.mj, self.built.grippers[self.gripper.name]
        T = self.T_root_tcp @ trial.T_object_tcp.inverse()  # object pose in the hand's root frame
        up_here = np.asarray(trial.up) / np.linalg.norm(trial.up)
        up = T.rotation.matrix @ up_here
        lowest = min(
            extent(shape, X.rotation.matrix.T @ up_here)[0] + float(X.translation @ up_here)
            for shape, X in self.shapes
        )
        center = T.apply(self.center)
        foot = (
            center + (lowest - float(self.center @ up_here)) * up
        )  # on the support, below the center of mass
        # --- the start
        data = mujoco.MjData(mj)
        q = self.gripper.joint_position(trial.opening)
        hand = self.built.scene.model
        hand_positions = hand.default_positions()
        hand_positions[hand.columns(self.gripper.joint_names)] = q
        for name, value in kinematic_tree(hand).full_positions(hand_positions).items():  # closes linkages
            data.qpos[mj.joint(name).qposadr[0]] = value
        start = self.built.object_qpos[OBJECT]
        data.qpos[start : start + 3], data.qpos[start + 3 : start + 7] = T.translation, T.quat_wxyz
        initial = np.empty(mujoco.mj_stateSize(mj, STATE))
        mujoco.mj_getState(mj, data, initial, STATE)
        dt, sealed = s.timestep, ()
        if isinstance(self.gripper, SuctionGripper):
            sealed, close = self._sealed(data), EVACUATED * self.gripper.evacuation
        else:  # finger speed up to the expected contact, then rising force
            meet = abs(q - self.gripper.joint_position(trial.width))
            kp = servo_gains(self.gripper, PhysicsSettings())[0]
            press = (
                trial.force * abs(self.gripper.width_per_joint) / kp
                + 0.004 / self.gripper.finger_travel_per_joint
            )
            rate = s.force_rate * abs(self.gripper.width_per_joint) / kp
            meeting, pressing = meet / index.max_speed, press / rate
            close = meeting + pressing
        total = close + s.settle + s.lift + s.shake + s.hold
        time = dt * np.arange(int(np.ceil(total / dt)))
        # --- the support moves away; weight and shaking act as forces on the object
        lifting = np.clip(time - close - s.settle, 0.0, None)
        away = np.minimum(0.5 * 6.0 * lifting**2, 0.5)
        shaking = lifting - s.lift
        on = (shaking > 0) & (shaking < s.shake)
        phase = 2 * np.pi * s.frequency * shaking
        R = self.T_root_tcp.rotation.matrix
        third = np.clip(np.floor(3 * shaking / s.shake), 0, 2).astype(int)
        axes = np.stack([R[:, 1], R[:, 0], up])[third]
        pull = -9.81 * (1 + s.extra_weight * ((lifting > 0) & (lifting < s.lift)))[:, None] * up
        pull = pull + np.where(on, s.acceleration * np.sin(phase), 0.0)[:, None] * axes
        control = np.zeros((len(time), mj.nu + 6 * mj.nbody + 7))
        if isinstance(self.gripper, SuctionGripper):
            for k in sealed:
                level = 1.0 - np.exp(-time / self.gripper.evacuation)
                control[:, self.built.cups[k].ctrl] = level
        else:
            ways = np.sign(self.gripper.width_per_joint)
            travel = np.minimum(time, meeting) * index.max_speed + np.clip(
                (time - meeting) * rate, 0.0, press
            )
            control[:, index.ctrl] = q - ways * travel
        control[:, mj.nu + 6 * self.body : mj.nu + 6 * self.body + 3] = trial.mass * pull
        control[:, -7:-4] = foot - (SUPPORT_THICK / 2 + FREE_GAP + away)[:, None] * up
        control[:, -4:] = SE3(SO3.between((0, 0, 1), up), foot).quat_wxyz
        return _Plan(initial, control, int((close + s.settle) / dt), len(time) - 1, sealed)

    def _sealed(self, data: mujoco.MjData) -> tuple[int, ...]:
        """Return the suction cups that seal on the object in a state of a grasp trial."""
        mujoco.mj_forward(self.mj, data)
        owner = np.asarray(self.built.geom_owner, np.int64)
        self.suction.update(data.ncon, data.contact.geom, owner, data.ctrl)
        return tuple(np.flatnonzero(self.suction.sealed == self.built.owner_index[OBJECT]).tolist())

    def _leaks(self, plan: _Plan, state: Array) -> bool:
        """Return whether a suction cup of the gripper leaks during a grasp trial. The result is False for
        grippers with jaws.

        MuJoCo's threads do not switch the vacuum of a leaking cup off, so a leak counts as a lost object.
        """
        if not isinstance(self.gripper, SuctionGripper):
            return False
        data, every = mujoco.MjData(self.mj), round(SEAL_CHECK / self.settings.timestep)
        for row in state[plan.closed : plan.end : every]:
            mujoco.mj_setState(self.mj, data, row, STATE)
            if not plan.sealed or not set(plan.sealed) <= set(self._sealed(data)):
                return True
        return False

    def result(self, plan: _Plan, state: Array) -> TrialResult:
        if not np.isfinite(state).all():
            return TrialResult(np.inf, np.inf, np.inf, True)
        at = 1 + self.built.object_qpos[OBJECT]  # the state vector starts with the time
        before, closed, end = (
            SE3.from_quat_wxyz(row[at : at + 3], row[at + 3 : at + 7])
            for row in (plan.initial, state[plan.closed], state[plan.end])
        )
        turn = closed.distance_to(end)[1]
        between = closed.inverse().apply(self.T_root_tcp.translation)  # the object's point at the tcp
        slip = float(np.linalg.norm(closed.apply(between) - end.apply(between)))
        closing = float(np.linalg.norm(before.apply(self.center) - closed.apply(self.center)))
        return TrialResult(closing, slip, turn, slip > 0.03 or self._leaks(plan, state))


@lru_cache(maxsize=8)
def _hand(model: RobotModel, gripper: Gripper) -> RobotModel:
    return hand_alone(model, gripper)
