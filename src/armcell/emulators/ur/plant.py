"""Simulated arms of the emulated UR controller: servo lag or physics, and injected faults.

Faults: unknown payload, joint offset, blocked joint.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core import SE3, SO3
from armcell.drivers.ur.wire.kinematics import pose_of
from armcell.drivers.ur.wire.models import ur_model
from armcell.emulators.rack import SharedWorld

F64 = NDArray[np.float64]

NOTHING = (np.zeros(3), np.zeros(3), np.zeros(3))
ABOUT_Z = SE3(SO3.exp((0.0, 0.0, np.pi)), np.zeros(3))  # controller's base in the model's base_link
SERVO_LAG = 0.008  # [s] approximate lag of a UR's joints behind their target
WORDS = "armcell fault payload <kg> | offset <0-5> <rad> | block <0-5> | arm none"


class Plant(Protocol):
    """Interface of a plant for one emulated UR arm: its simulated joints and gripper.

    Attributes:
        resets: number of resets to the start.
    """

    resets: int

    def reset(self) -> None:
        """Reset the joints of a UR plant to their initial state,
        or the whole world if several arms share it.
        """
        ...

    def read(self) -> tuple[F64, F64, F64]:
        """Return the joint positions [rad], velocities [rad/s] and
        efforts [Nm] of the UR plant, each (6,).
        """
        ...

    def command(self, q: F64, v: F64, period: float) -> None:
        """Set the joint targets (positions and velocities, each (6,))
        of the UR plant for one control period [s].
        """
        ...

    def step(self, dt: float) -> None:
        """Advance the plant of an emulated UR arm by one control period [s]. Arms that share a physics world
        advance the world together.

        Each of n arms advances the world by 1/n of the period.
        """
        ...

    def displace(self, q: ArrayLike) -> None:
        """Set the joint positions of the UR emulator's plant (simulated arm) at once, as if a person had
        moved the arm by hand.
        """
        ...

    def contact(self, hand: bool = True) -> str | None:
        """Describe an unexpected contact of the arm in the UR plant since the last call, or return None.

        Args:
            hand: whether contacts of the hand count.
        """
        ...

    def wrench(self) -> tuple[F64, F64, F64]:
        """Return the contact force [N] and torque [Nm] on the hand of the UR plant,
        and their reference point [m].

        All three are (3,) vectors in the base frame.
        """
        ...

    def drive_gripper(self, opening: float, force: float) -> None:
        """Move the gripper of the UR plant to an opening with limited force.

        Args:
            opening: 0..1 of the largest opening; 0 grasps.
            force: 0..1 of the largest force.
        """
        ...

    def gripper(self) -> tuple[float, bool]:
        """Return the gripper opening of the UR plant as a fraction of the largest opening (0..1), and whether
        the gripper holds an object.
        """
        ...

    def object_pose(self, name: str) -> list[float]:
        """Return the world pose of an object in the world of the UR plant: x, y, z [m] and rotation vector
        [rad].

        Raises:
            ValueError: no object has this name.
        """
        ...


class KinematicPlant:
    """Plant (simulated arm) of the UR emulator without physics. Each joint follows its target with the servo
    lag of a real UR.
    """

    def __init__(self, q: ArrayLike):
        self._start = np.array(q, dtype=float)
        self.resets = -1
        self.reset()

    def reset(self) -> None:
        self.displace(self._start)
        self._opening, self._wanted = 1.0, 1.0
        self.resets += 1

    def read(self) -> tuple[F64, F64, F64]:
        return self._q, self._v, np.zeros(6)

    def command(self, q: F64, v: F64, period: float) -> None:
        self._target = q

    def step(self, dt: float) -> None:
        moved = self._q + (self._target - self._q) * (1.0 - np.exp(-dt / SERVO_LAG))
        self._v = (moved - self._q) / dt
        self._q = moved
        self._opening += float(np.clip(self._wanted - self._opening, -dt, dt))

    def displace(self, q: ArrayLike) -> None:
        self._q, self._v = np.array(q, dtype=float), np.zeros(6)
        self._target = self._q.copy()

    def contact(self, hand: bool = True) -> str | None:
        return None

    def wrench(self) -> tuple[F64, F64, F64]:
        return NOTHING

    def drive_gripper(self, opening: float, force: float) -> None:
        self._wanted = float(np.clip(opening, 0.0, 1.0))

    def gripper(self) -> tuple[float, bool]:
        return self._opening, False

    def object_pose(self, name: str) -> list[float]:
        raise ValueError("there is no world")


class PhysicsPlant:
    """Plant of an emulated UR controller: an arm with its gripper in a physics world.

    Between two commands of the controller, joint targets are interpolated linearly, as in a real drive.

    Args:
        group: planning group of the arm.
        model: type of the arm, such as UR10e, which determines the control period.
    """

    def __init__(self, shared: SharedWorld, group: str, model: str):
        self._shared, self.world = shared, shared.world
        shared.join(self, 1.0 / ur_model(model).frequency)
        world = self.world
        self._names: Sequence[str] = world.robot.group(group).joint_names
        self._columns = world.robot.columns(tuple(self._names))
        self._qpos, self._dofs = world.built.qpos[self._columns], world.built.dofs[self._columns]
        found = [g for g in world.robot.grippers.values() if g.arm_group == group]
        self._gripper = found[0] if found else None
        self._force = 0.0
        self._links = set(world.robot.group(group).link_names)
        self.tool_link = world.robot.joints[self._names[-1]].child
        self._base = world.robot.joints[self._names[0]].parent
        self._hand = set(self._gripper.hand_links) if self._gripper else set()
        self.resets = -1
        self.follow_reset()

    def reset(self) -> None:
        self._shared.reset()

    def follow_reset(self) -> None:
        """Let the UR plant continue from the initial state after the shared world was reset."""
        self.resets += 1
        self._seen, self._force = 0, 0.0
        self._rest()
        movable = tuple(self.world.built.object_qpos)
        for link in self._hand:
            self.world.monitor.allow(link, movable)  # a gripper may touch movable objects

    def read(self) -> tuple[F64, F64, F64]:
        data, qpos, dofs = self.world._data, self._qpos, self._dofs
        return data.qpos[qpos], data.qvel[dofs], data.qfrc_actuator[dofs] + data.qfrc_gravcomp[dofs]

    def _rest(self) -> None:
        self._from = self._to = self.read()[0].copy()
        self._speed, self._begun, self._span = np.zeros(6), self.world.time, 1.0

    def command(self, q: F64, v: F64, period: float) -> None:
        self._from = self._interpolated_targets(self.world.time)
        self._to, self._speed = np.array(q), np.array(v)
        self._begun, self._span = self.world.time, period

    def _interpolated_targets(self, time: float) -> F64:
        share = min(max((time - self._begun) / self._span, 0.0), 1.0)
        return self._from + share * (self._to - self._from)

    def set_joint_targets(self, time: float) -> None:
        """Interpolate the latest joint command of the UR plant at a world time [s],
        and set the result as the joint targets in the physics world.

        If no new command arrives, the arm holds the latest target.
        """
        over = time > self._begun + 1.5 * self._span  # no new command: hold the target
        self.world.set_arm_target(
            self._names, self._interpolated_targets(time), np.zeros(6) if over else self._speed
        )

    def step(self, dt: float) -> None:
        self._shared.advance(dt)

    def displace(self, q: ArrayLike) -> None:
        positions = np.array(self.world.joint_state().positions)
        positions[self._columns] = q
        self.world.set_positions(np.clip(positions, self.world.robot.lower, self.world.robot.upper))
        self._rest()

    def contact(self, hand: bool = True) -> str | None:
        links = self._links if hand else self._links - self._hand
        new = self.world.monitor.unwanted[self._seen :]
        self._seen += len(new)
        for touch in new:
            if links & {touch.body_a, touch.body_b}:
                return f"{touch.body_a} touched {touch.body_b}"
        return None

    def wrench(self) -> tuple[F64, F64, F64]:
        if self._gripper is None:
            return NOTHING
        felt = self.world.wrench(self._gripper.name)
        if not felt.any():
            return NOTHING
        T_base_world = (self.world.link_pose(self._base) @ ABOUT_Z).inverse()
        R = T_base_world.rotation.matrix
        at = T_base_world.apply(self.world.link_pose(self._gripper.tcp_link).translation)
        return R @ felt[:3], R @ felt[3:], at

    def drive_gripper(self, opening: float, force: float) -> None:
        if self._gripper is not None:
            wanted = float(np.clip(force, 0.0, 1.0)) * self._gripper.max_force
            strongest = self.world.built.grippers[self._gripper.name].max_force  # by the physics settings
            self._force = min(max(wanted, 0.5), strongest)
            width = float(np.clip(opening, 0.0, 1.0)) * self._gripper.max_width
            self.world.set_gripper_target(self._gripper.name, width, self._force)

    def gripper(self) -> tuple[float, bool]:
        if self._gripper is None:
            return 0.0, False
        state = self.world.gripper_state(self._gripper.name)
        holds = state.held is not None and state.force_per_finger >= 0.8 * self._force > 0.0
        return float(np.clip(state.width / self._gripper.max_width, 0.0, 1.0)), holds

    def object_pose(self, name: str) -> list[float]:
        if name not in self.world.built.objects:
            raise ValueError(f"no object {name!r}")
        return pose_of(self.world.object_pose(name).matrix)


class FaultyPlant:
    """Wrapper that injects faults into the plant (simulated arm) of the UR emulator. Without a fault, it
    forwards every call to the wrapped plant.
    """

    def __init__(self, plant: Plant):
        self._plant = plant
        self._offset = np.zeros(6)
        self._blocked: dict[int, float] = {}  # joint -> blocked position [rad]

    def __getattr__(self, name: str) -> Any:
        return getattr(self._plant, name)

    def command(self, q: F64, v: F64, *more: Any) -> None:
        q, v = np.array(q, dtype=float) + self._offset, np.array(v, dtype=float)
        if not hasattr(self._plant, "world"):  # physics blocks the joint itself
            for joint, at in self._blocked.items():
                q[joint], v[joint] = at, 0.0
        self._plant.command(q, v, *more)

    def offset(self, joint: int, angle: float) -> None:
        """Inject a fault into the UR plant (simulated arm): add a constant error [rad] to the commanded
        position of one joint.
        """
        self._offset[joint] = angle

    def block(self, joint: int) -> None:
        """Inject a fault into the UR plant: block a joint at its present position, whatever its motor
        does.
        """
        self._blocked[joint] = float(self._plant.read()[0][joint])
        if hasattr(self._plant, "world"):
            world: Any = self._plant
            world.world.block(world.world.robot.joint_names[world._columns[joint]])

    def payload(self, mass: float) -> None:
        """Inject a fault into the UR plant: a mass [kg] is attached to
        the last link without informing the controller.

        Raises:
            ValueError: the arm has no physics, so the mass would have no effect.
        """
        if not hasattr(self._plant, "world"):
            raise ValueError("no physics")
        plant: Any = self._plant
        plant.world.add_load(plant.tool_link, mass)


def set_fault(plant: Any, words: list[str]) -> Any:
    """Inject the fault that a command describes into the plant (simulated arm) of the UR emulator, and return
    the plant with the fault. For the command "arm none", return the original plant.

    Raises:
        ValueError: the words name no fault.
    """
    if words == ["arm", "none"]:
        return plant._plant if isinstance(plant, FaultyPlant) else plant  # masses and blocks stay
    faulty = plant if isinstance(plant, FaultyPlant) else FaultyPlant(plant)
    match words:
        case ["payload", mass]:
            faulty.payload(float(mass))
        case ["offset", joint, angle]:
            faulty.offset(int(joint), float(angle))
        case ["block", joint]:
            faulty.block(int(joint))
        case _:
            raise ValueError
    return faulty
