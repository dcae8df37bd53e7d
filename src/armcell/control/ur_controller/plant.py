"""What moves behind the emulated controller: joints that follow exactly, or physics."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.sim import SimWorld

Array = NDArray[np.float64]

SERVO_LAG = 0.008  # [s] by which a UR's joints follow their target, about


class Plant(Protocol):
    """One arm's joints, and its gripper where it has one."""

    def read(self) -> tuple[Array, Array, Array]:
        """Positions, velocities, efforts (6,)."""
        ...

    def command(self, q: Array, v: Array) -> None: ...

    def step(self, dt: float) -> None:
        """Let time pass; what several arms share passes only at the first one's call."""
        ...

    def displace(self, q: ArrayLike) -> None:
        """Put the joints elsewhere, as a hand does."""
        ...

    def contact(self) -> str | None:
        """A touch of something unexpected since the last call."""
        ...

    def drive_gripper(self, opening: float, force: float) -> None:
        """Towards an opening (0..1 of the widest; 0 grasps) with a part (0..1) of the largest force."""
        ...

    def gripper(self) -> tuple[float, bool]:
        """Opening (0..1 of the widest) and whether something is held."""
        ...


class KinematicPlant:
    """Joints that follow their targets with a UR's lag; no physics."""

    def __init__(self, q: ArrayLike):
        self._q, self._v = np.array(q, dtype=float), np.zeros(6)
        self._target = self._q.copy()
        self._opening, self._wanted = 1.0, 1.0

    def read(self) -> tuple[Array, Array, Array]:
        return self._q, self._v, np.zeros(6)

    def command(self, q: Array, v: Array) -> None:
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

    def drive_gripper(self, opening: float, force: float) -> None:
        self._wanted = float(np.clip(opening, 0.0, 1.0))

    def gripper(self) -> tuple[float, bool]:
        return self._opening, False


class WorldPlant:
    """One arm of a physics world. The first arm of a world lets its time pass."""

    def __init__(self, world: SimWorld, group: str, leads: bool):
        self.world, self._leads = world, leads
        self._names: Sequence[str] = world.robot.group(group).joint_names
        self._columns = world.robot.columns(tuple(self._names))
        found = [g for g in world.robot.grippers.values() if g.arm_group == group]
        self._gripper = found[0] if found else None
        self._force = 0.0
        self._links = set(world.robot.group(group).link_names)
        self.tool_link = world.robot.joints[self._names[-1]].child
        self._seen = 0
        movable = tuple(world.built.object_qpos)
        for link in self._gripper.hand_links if self._gripper else ():
            world.monitor.allow(link, movable)  # a gripper is there to touch what can be moved

    def read(self) -> tuple[Array, Array, Array]:
        state = self.world.joint_state()
        columns = self._columns
        assert state.velocities is not None and state.efforts is not None
        return state.positions[columns], state.velocities[columns], state.efforts[columns]

    def command(self, q: Array, v: Array) -> None:
        self.world.set_arm_target(self._names, q, v)

    def step(self, dt: float) -> None:
        if self._leads:
            self.world.step(max(round(dt / self.world.timestep), 1))

    def displace(self, q: ArrayLike) -> None:
        positions = np.array(self.world.joint_state().positions)
        positions[self._columns] = q
        self.world.set_positions(np.clip(positions, self.world.robot.lower, self.world.robot.upper))

    def contact(self) -> str | None:
        new = self.world.monitor.unwanted[self._seen :]
        self._seen += len(new)
        for touch in new:
            if self._links & {touch.body_a, touch.body_b}:
                return f"{touch.body_a} touched {touch.body_b}"
        return None

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
