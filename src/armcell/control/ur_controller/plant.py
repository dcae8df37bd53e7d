"""What moves behind the emulated controller: joints that follow exactly, or physics."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.control.ur_wire.kinematics import pose_of
from armcell.core import SE3, SO3, InputError
from armcell.sim import SimWorld

Array = NDArray[np.float64]

NOTHING = (np.zeros(3), np.zeros(3), np.zeros(3))
ABOUT_Z = SE3(SO3.exp((0.0, 0.0, np.pi)), np.zeros(3))  # from a model's base_link to the controller's base
SERVO_LAG = 0.008  # [s] by which a UR's joints follow their target, about


class Plant(Protocol):
    """One arm's joints, and its gripper where it has one."""

    def read(self) -> tuple[Array, Array, Array]:
        """Positions, velocities, efforts (6,)."""
        ...

    def command(self, q: Array, v: Array, period: float) -> None:
        """Where the joints shall be a control period [s] from now, and how fast."""
        ...

    def step(self, dt: float) -> None:
        """Let a control period [s] pass. Of arms that share a world each lets its part of it pass."""
        ...

    def displace(self, q: ArrayLike) -> None:
        """Put the joints elsewhere, as a hand does."""
        ...

    def contact(self) -> str | None:
        """A touch of something unexpected since the last call."""
        ...

    def wrench(self) -> tuple[Array, Array, Array]:
        """Force [N] and torque [Nm] on the hand by touches, about a point [m]; in the base frame."""
        ...

    def drive_gripper(self, opening: float, force: float) -> None:
        """Towards an opening (0..1 of the widest; 0 grasps) with a part (0..1) of the largest force."""
        ...

    def gripper(self) -> tuple[float, bool]:
        """Opening (0..1 of the widest) and whether something is held."""
        ...

    def object_pose(self, name: str) -> list[float]:
        """x, y, z [m] and rotation vector [rad] of an object in the world.

        Raises:
            ValueError: there is none of that name.
        """
        ...


class KinematicPlant:
    """Joints that follow their targets with a UR's lag; no physics."""

    def __init__(self, q: ArrayLike):
        self._q, self._v = np.array(q, dtype=float), np.zeros(6)
        self._target = self._q.copy()
        self._opening, self._wanted = 1.0, 1.0

    def read(self) -> tuple[Array, Array, Array]:
        return self._q, self._v, np.zeros(6)

    def command(self, q: Array, v: Array, period: float) -> None:
        self._target = q

    def step(self, dt: float) -> None:
        moved = self._q + (self._target - self._q) * (1.0 - np.exp(-dt / SERVO_LAG))
        self._v = (moved - self._q) / dt
        self._q = moved
        self._opening += float(np.clip(self._wanted - self._opening, -dt, dt))

    def displace(self, q: ArrayLike) -> None:
        self._q, self._v = np.array(q, dtype=float), np.zeros(6)
        self._target = self._q.copy()

    def contact(self) -> str | None:
        return None

    def wrench(self) -> tuple[Array, Array, Array]:
        return NOTHING

    def drive_gripper(self, opening: float, force: float) -> None:
        self._wanted = float(np.clip(opening, 0.0, 1.0))

    def gripper(self) -> tuple[float, bool]:
        return self._opening, False

    def object_pose(self, name: str) -> list[float]:
        raise ValueError("there is no world")


class SharedWorld:
    """A physics world with one or several arms of it, each driven by a controller of its own.

    Between two commands of a controller its joints' targets go evenly from one to the next, as a drive's do.
    """

    def __init__(self, world: SimWorld, groups: Sequence[str]):
        self.world = world
        self.plants = [WorldPlant(self, group) for group in groups]
        self._owed = 0.0  # [s]

    def advance(self, dt: float) -> None:
        """Let the world's time pass [s]; what is less than a step of it is kept for the next time."""
        self._owed += dt
        step = self.world.timestep
        while self._owed >= step - 1e-9:
            for plant in self.plants:
                plant.aim(self.world.time + step)
            self.world.step()
            self._owed -= step


class WorldPlant:
    """One arm of a physics world, with its gripper."""

    def __init__(self, shared: SharedWorld, group: str):
        self._shared, self.world = shared, shared.world
        world = self.world
        self._names: Sequence[str] = world.robot.group(group).joint_names
        self._columns = world.robot.columns(tuple(self._names))
        found = [g for g in world.robot.grippers.values() if g.arm_group == group]
        self._gripper = found[0] if found else None
        self._force = 0.0
        self._links = set(world.robot.group(group).link_names)
        self.tool_link = world.robot.joints[self._names[-1]].child
        self._base = world.robot.joints[self._names[0]].parent
        self._seen = 0
        self._rest()
        movable = tuple(world.built.object_qpos)
        for link in self._gripper.hand_links if self._gripper else ():
            world.monitor.allow(link, movable)  # a gripper is there to touch what can be moved

    def read(self) -> tuple[Array, Array, Array]:
        state = self.world.joint_state()
        columns = self._columns
        if state.velocities is None or state.efforts is None:
            raise InputError("the shared world tells no speeds and efforts", cure="share a SimWorld")
        return state.positions[columns], state.velocities[columns], state.efforts[columns]

    def _rest(self) -> None:
        self._from = self._to = self.read()[0].copy()
        self._speed, self._begun, self._span = np.zeros(6), self.world.time, 1.0

    def command(self, q: Array, v: Array, period: float) -> None:
        self._from = self._aimed(self.world.time)
        self._to, self._speed = np.array(q), np.array(v)
        self._begun, self._span = self.world.time, period

    def _aimed(self, time: float) -> Array:
        share = min(max((time - self._begun) / self._span, 0.0), 1.0)
        return self._from + share * (self._to - self._from)

    def aim(self, time: float) -> None:
        """Give the world the targets for a time of it [s]."""
        over = time > self._begun + 1.5 * self._span  # no command came: the target stands
        self.world.set_arm_target(self._names, self._aimed(time), np.zeros(6) if over else self._speed)

    def step(self, dt: float) -> None:
        self._shared.advance(dt / len(self._shared.plants))

    def displace(self, q: ArrayLike) -> None:
        positions = np.array(self.world.joint_state().positions)
        positions[self._columns] = q
        self.world.set_positions(np.clip(positions, self.world.robot.lower, self.world.robot.upper))
        self._rest()

    def contact(self) -> str | None:
        new = self.world.monitor.unwanted[self._seen :]
        self._seen += len(new)
        for touch in new:
            if self._links & {touch.body_a, touch.body_b}:
                return f"{touch.body_a} touched {touch.body_b}"
        return None

    def wrench(self) -> tuple[Array, Array, Array]:
        if self._gripper is None:
            return NOTHING
        felt = self.world.wrench(self._gripper.name)
        T_base_world = (self.world.link_pose(self._base) @ ABOUT_Z).inv()
        R = T_base_world.rotation.matrix
        at = T_base_world.apply(self.world.link_pose(self._gripper.tcp_link).translation)
        return R @ felt[:3], R @ felt[3:], at

    def drive_gripper(self, opening: float, force: float) -> None:
        if self._gripper is not None:
            self._force = max(float(np.clip(force, 0.0, 1.0)) * self._gripper.max_force, 0.5)
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
