"""Simulated robot: an implementation of Driver on MuJoCo."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import AbstractContextManager
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from armcell.core import SE3, ArmcellError, Contact, InputError, JointState, Playback
from armcell.drivers.driver import (
    Array,
    Capability,
    ContactRecord,
    Driver,
    DriverOptions,
    GripperReading,
    WeldRecord,
    drivers,
)
from armcell.scene import PlanningScene
from armcell.sim import JointTargets, Pacer, PhysicsSettings, SimWorld

PERIOD = 0.004  # [s] between commands, rounded to whole physics steps


class SteppedSim(Driver):
    """Driver for the MuJoCo simulation with one command per control period. Simulated time advances in
    lock-step with the commands or is paced by wall time.

    Lock-step runs as fast as the computer allows.
    """

    name = "sim"
    is_simulated = True
    capabilities = frozenset({Capability.MEASURE_FORCE, Capability.KNOW_CONTACTS})

    def __init__(self, scene: PlanningScene, options: DriverOptions):
        self._scene, self._options = scene, options
        self._settings = options.physics or PhysicsSettings()
        self.period = max(round(PERIOD / self._settings.timestep), 1) * self._settings.timestep
        self._pacer = Pacer(options.time_scale)
        self.world: SimWorld = None  # type: ignore[assignment]  # set by __enter__

    def __enter__(self) -> Self:
        o = self._options
        self.world = SimWorld(self._scene, self._settings, o.cameras, o.seed, o.decals)
        self._pacer.reset()
        return self

    def __exit__(self, *exc: object) -> None:
        pass  # the state stays readable; `LiveCell.release` gives the world's model back

    @property
    def lock(self) -> AbstractContextManager[Any]:
        """Return the lock of the simulation driver, for reads outside the thread that advances time."""
        return self.world.lock

    @property
    def is_paced(self) -> bool:
        return self._pacer.time_scale is not None

    @property
    def now(self) -> float:
        return self.world.time

    def joint_state(self) -> JointState:
        return self.world.joint_state()

    def command(
        self, joint_names: tuple[str, ...], positions: ArrayLike, velocities: ArrayLike
    ) -> JointState:
        self.world.set_arm_target(joint_names, positions, velocities)
        q, v = np.array(positions, dtype=float), np.array(velocities, dtype=float)
        return JointState.unchecked(joint_names, q, v, time=self.now)  # validated by the world

    def command_gripper(self, gripper: str, width: float, force: float) -> None:
        self.world.set_gripper_target(gripper, width, force)

    def gripper(self, gripper: str) -> GripperReading:
        state = self.world.gripper_state(gripper)
        return GripperReading(
            state.width, state.force_per_finger, state.held, sealed=state.sealed, vacuum=state.vacuum
        )

    def wrench(self, gripper: str) -> Array:
        return self.world.wrench(gripper)

    def advance(self, duration: float) -> None:
        self.world.step(max(round(duration / self._settings.timestep), 1))
        self._pacer.wait_until(self.world.time)

    def stop(self) -> None:
        state = self.world.joint_state()
        fingers = {name for g in self.world.robot.grippers.values() for name in g.joint_names}
        arm = state.reindexed(n for n in state.joint_names if n not in fingers)
        self.world.set_arm_target(arm.joint_names, arm.positions)

    def resume(self) -> None:
        """Check that the simulation driver can continue. Only diverged physics stops it for good."""
        try:
            self._connected().check()
        except ArmcellError as error:
            raise InputError(f"cannot resume: {error}", hint="connect the cell again") from None

    def _connected(self) -> SimWorld:
        if self.world is None:
            raise InputError("the simulation has not begun", hint="connect first: with driver: ...")
        return self.world

    def object_poses(self) -> dict[str, SE3]:
        return self.world.object_poses()

    def targets(self) -> JointState | None:
        return self.world.arm_target()

    def contacts(self) -> list[Contact]:
        return [Contact(c.body_a, c.body_b, -c.depth, c.position) for c in self.world.contacts()]

    def expect_contact(self, body: str, others: Iterable[str], expected: bool = True) -> None:
        (self.world.monitor.allow if expected else self.world.monitor.forbid)(body, tuple(others))

    def watch_object(self, name: str, supports: Iterable[str] = ()) -> None:
        self.world.monitor.watch(name, supports)

    def unwatch_object(self, name: str) -> None:
        self.world.monitor.unwatch(name)

    def unwanted_contacts(self) -> list[ContactRecord]:
        return [
            ContactRecord(c.body_a, c.body_b, c.time, c.depth, c.count) for c in self.world.monitor.unwanted
        ]

    def welds(self) -> list[WeldRecord]:
        return [WeldRecord(w.object, w.gripper, w.time, w.reason, w.released_at) for w in self.world.welds]


class SimDriver(SteppedSim):
    """Driver for the MuJoCo simulation that can also execute part of a trajectory in a single call, instead
    of one command per control period.
    """

    capabilities = SteppedSim.capabilities | {Capability.PLAY_PARTS}

    def __init__(self, scene: PlanningScene, options: DriverOptions):
        super().__init__(scene, options)
        self._played: tuple[Playback, float, JointTargets] | None = (
            None  # playback, start time [s], its targets
        )

    def play(
        self, joint_names: tuple[str, ...], playback: Playback, began: float, until: float, tolerance: float
    ) -> tuple[float, int]:
        """Play a part of a trajectory with the simulation driver,
        until a given time or until the tracking error is too large.
        """
        if self._played is None or self._played[:2] != (playback, began):
            self._played = playback, began, self._targets_of(playback, began)
        found = self.world.follow(joint_names, self._played[2], began + until - 1e-9, tolerance)
        self._pacer.wait_until(self.world.time)
        return found

    def _targets_of(self, playback: Playback, began: float) -> JointTargets:
        period, duration = self.period, playback.duration

        def wanted(times: Array) -> tuple[Array, Array]:
            return playback.at_times(np.minimum(times - began + period, duration))

        timestep = self._settings.timestep
        return JointTargets(wanted, timestep, round(period / timestep))


drivers.register("sim")(SimDriver)  # not a decorator: type checkers would lose the class
