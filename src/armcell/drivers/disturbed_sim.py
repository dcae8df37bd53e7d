"""Disturbances of a simulated cell that a test campaign varies, and the simulated robot that has them.

The physics stays correct; the driver reads and commands joints as a real controller would, with joint
positions in the encoders' frame and delayed commands. Object poses and slip are reported without error.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from armcell.core import SE3, SO3, JointState
from armcell.drivers.driver import Array, DriverOptions
from armcell.drivers.sim import SteppedSim
from armcell.scene import PlanningScene


@dataclass(frozen=True)
class Push:
    """Disturbance of a simulated cell: an external force that pushes a
    link or object at its center, given in world axes.

    Attributes:
        on: name of the link or object.
        at: start time [s] on the driver's clock.
        duration: [s]
        force: (3,) [N]
    """

    on: str
    at: float
    duration: float
    force: tuple[float, float, float]


@dataclass(frozen=True)
class Displacement:
    """Disturbance of a simulated cell that displaces an object during a run.
    Only cameras can observe the displacement.

    Attributes:
        object: name of a fixed or movable object.
        at: time [s] on the driver's clock.
        by: displacement (3,) [m] from the object's pose at that time, in world axes.
        turn: rotation [rad] about the vertical axis through the object's origin.
    """

    object: str
    at: float
    by: tuple[float, float, float]
    turn: float


@dataclass(frozen=True)
class Disturbances:
    """All disturbances of one simulated cell. By default there are none.

    Attributes:
        joint_offsets: joint name to offset [rad] of the true joint position from the encoder's reading.
        joint_noise: standard deviation [rad] of the measured arm positions, independent per joint and time.
        latency: delay [s] between a command to the arm and its effect.
        pushes: external forces.
        moves: displacements of objects.
    """

    joint_offsets: Mapping[str, float] = field(default_factory=dict)
    joint_noise: float = 0.0
    latency: float = 0.0
    pushes: tuple[Push, ...] = ()
    moves: tuple[Displacement, ...] = ()

    def __bool__(self) -> bool:
        of_the_arm = any(self.joint_offsets.values()) or self.joint_noise or self.latency
        return bool(of_the_arm or self.pushes or self.moves)


class DisturbedSim(SteppedSim):
    """Simulation driver that applies `Disturbances` to every command and every joint reading.

    The driver cannot play parts of a trajectory itself, so no command bypasses the disturbances.
    """

    def __init__(self, scene: PlanningScene, options: DriverOptions, disturbances: Disturbances):
        super().__init__(scene, options)
        self.disturbances = disturbances
        model = scene.model
        fingers = {name for g in model.grippers.values() for name in g.joint_names}
        self._arm = np.array([n not in fingers for n in model.joint_names])
        self._offset = np.array([disturbances.joint_offsets.get(n, 0.0) for n in model.joint_names])
        self._offset_of = dict(zip(model.joint_names, self._offset.tolist(), strict=True))
        self._late: deque[tuple[int, tuple[str, ...], Array, Array]] = deque()
        self._steps = 0  # physics steps since the start
        step = self._settings.timestep
        self._pushes = [  # first step, end step, push
            (first := round(push.at / step), first + max(round(push.duration / step), 1), push)
            for push in disturbances.pushes
        ]
        self._moves = sorted(((round(move.at / step), move) for move in disturbances.moves), key=_step)
        self._moved = 0  # number of applied displacements

    def __enter__(self) -> Self:
        super().__enter__()
        model = self._scene.model
        self.world.set_positions(np.clip(self._scene.positions + self._offset, model.lower, model.upper))
        self._late.clear()
        self._steps = self._moved = 0
        self._move()  # displacements at time 0: cameras may look before time passes
        return self

    # --- measurements ---
    def joint_state(self) -> JointState:
        state = self.world.joint_state()
        noise = np.zeros(len(self._offset))
        if self.disturbances.joint_noise:  # depends on the time, not on the number of calls
            rng = np.random.default_rng((self._options.seed, self._steps))
            noise = self._arm * rng.normal(0.0, self.disturbances.joint_noise, len(self._offset))
        return replace(state, positions=state.positions - self._offset + noise)

    def targets(self) -> JointState | None:
        target = self.world.arm_target()
        return replace(target, positions=target.positions - self._offsets(target.joint_names))

    def _offsets(self, names: tuple[str, ...]) -> Array:
        return np.array([self._offset_of[n] for n in names])

    # --- commands ---
    def command(
        self, joint_names: tuple[str, ...], positions: ArrayLike, velocities: ArrayLike
    ) -> JointState:
        names = tuple(joint_names)
        q, v = np.array(positions, dtype=float), np.array(velocities, dtype=float)
        due = self._steps + round(self.disturbances.latency / self._settings.timestep)
        self._late.append((due, names, q + self._offsets(names), v))
        self._act()
        return JointState(names, q, v, time=self.now)

    def stop(self) -> None:
        state = self.joint_state()
        names = tuple(n for n, arm in zip(state.joint_names, self._arm, strict=True) if arm)
        self.command(names, state.reindexed(names).positions, np.zeros(len(names)))

    def _act(self) -> None:
        """Send each joint command of the disturbed simulation whose delay has elapsed."""
        while self._late and self._late[0][0] <= self._steps:
            _, names, q, v = self._late.popleft()
            self.world.set_arm_target(names, q, v)

    # --- time ---
    def advance(self, duration: float) -> None:
        end = self._steps + max(round(duration / self._settings.timestep), 1)
        while self._steps < end:
            self._act()
            self._push()
            self._move()
            until = min((step for step in self._events() if step > self._steps), default=end)
            self.world.step(min(until, end) - self._steps)
            self._steps = min(until, end)
        self._act()
        self._pacer.wait_until(self.world.time)

    def _events(self) -> Iterator[int]:
        """Yield the physics steps at which the disturbed simulation must act: apply a delayed command, start
        or end a push, or displace an object.
        """
        if self._late:
            yield self._late[0][0]
        for first, last, _ in self._pushes:
            yield from (first, last)
        yield from map(_step, self._moves[self._moved :])

    def _push(self) -> None:
        if not self._pushes:
            return
        forces = self.world.mj_data.xfrc_applied
        forces[:] = 0.0
        for first, last, push in self._pushes:
            if first <= self._steps < last:
                forces[self.world.built.body[push.on], :3] += push.force

    def _move(self) -> None:
        """Move objects of the disturbed simulation by each scheduled displacement whose start time has been
        reached.
        """
        while self._moved < len(self._moves) and self._moves[self._moved][0] <= self._steps:
            move = self._moves[self._moved][1]
            T = self.world.object_pose(move.object)
            turned = SO3.exp((0.0, 0.0, move.turn)) @ T.rotation
            self.world.set_object_pose(move.object, SE3(turned, T.translation + np.array(move.by)))
            self._moved += 1


def _step(planned: tuple[int, Displacement]) -> int:
    return planned[0]
