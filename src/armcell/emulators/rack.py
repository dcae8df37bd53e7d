"""Rack of emulated controllers in one thread: robot kinds, all real arms of a cell, shared physics world.

Paced by wall time. The arms may be of one or several vendors.
"""

from __future__ import annotations

import selectors
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, BinaryIO, Generic, Protocol, TypeVar

from armcell import _interrupts
from armcell.core import InputError, Registry
from armcell.drivers.real import RealSettings
from armcell.emulators.network import Network
from armcell.scene import PlanningScene
from armcell.sim import PhysicsSettings, SimWorld

IDLE = 1.0  # [s] without a client before a run counts as ended
TIE = 1e-4  # [s] steps that are due within this time of each other may run in either order
MAX_LAG = 1.0  # [s] largest delay behind wall time that is caught up; a larger delay is lost
emulated_kinds: Registry[EmulatedKind] = Registry("emulated kind of robot", "armcell.emulators")
"""Emulated robot kinds by the name that a cell file states in `real: {kind: ...}`."""


class EmulatedController(Protocol):
    """Interface of an emulated robot controller with its network ports. A `Rack` runs several of these
    controllers in one thread.

    Attributes:
        period: control period [s].
        answer_time: shortest time [s] from one control step to the next, in which a client can answer; a
            late emulator catches up only as far as this allows.
    """

    network: Network
    period: float
    answer_time: float

    @property
    def in_use(self) -> bool:
        """Return whether a client uses an emulated controller that runs in a `Rack`. A client that an
        injected fault has disconnected still counts.
        """
        ...

    def step(self) -> None:
        """Run one control step of an emulated robot and serve its network ports. A `Rack` calls this method
        once per control period.
        """
        ...

    def reset(self) -> None:
        """Reset an emulated controller in the rack: the arm and the world return to their initial state."""
        ...

    def trace(self) -> bytes:
        """Return the trace-file record of an emulated controller's last control step. A `Rack` writes the
        records of its controllers.
        """
        ...

    def close(self) -> None: ...


def selector() -> selectors.BaseSelector:
    """Return an I/O selector for the network ports of all emulated controllers in a `Rack`. The selector
    supports timeouts of less than 1 ms.

    epoll would round timeouts up to whole milliseconds.
    """
    return selectors.SelectSelector()


AnyController = TypeVar("AnyController", bound=EmulatedController)


class Rack(Generic[AnyController]):
    """Rack of emulated robot controllers: an event loop that runs several controllers in one thread, paced by
    wall time.

    Args:
        controllers: controllers on one selector.
        trace: file for the controllers' records: index of the controller (one byte), then its record.
        reset_between_runs: reset arms and objects to their start once all clients have disconnected.
    """

    def __init__(
        self,
        controllers: Sequence[AnyController],
        selector: selectors.BaseSelector,
        trace: BinaryIO | None = None,
        reset_between_runs: bool = False,
    ):
        self._trace, self._reset_between_runs = trace, reset_between_runs
        self._used_at: float | None = None  # [s] time of the last client; None: no client since a reset
        self._selector = selector
        self.controllers = list(controllers)
        self.lost = 0.0  # [s] of wall time that the emulation skipped
        self._stop = threading.Event()
        self._opened = False

    def open(self) -> None:
        """Open the ports of the emulated controllers in the rack. `run`
        also does this before it serves the clients.
        """
        if not self._opened:
            self._opened = True
            for controller in self.controllers:
                controller.step()  # triggers compilation on a machine's first run, before clients wait
            for controller in self.controllers:
                controller.network.open()

    def run(self) -> None:
        """Run the emulated controllers in the rack and serve their clients until `stop` is called.

        The controllers' cycles are offset within their periods, because real controllers are not synchronized
        either. Of the steps that are due, the one that must end first runs first: a Franka, whose client then
        has the time of a UR's step to answer. If the emulation is late, all controllers are: several arms may
        share a world.
        """
        self.open()
        count, begun = len(self.controllers), time.monotonic()
        spare = [c.period - c.answer_time for c in self.controllers]  # [s] from a due step to its latest end
        due = [begun + i * c.period / count for i, c in enumerate(self.controllers)]
        while not self._stop.is_set():
            _interrupts.check()
            now = time.monotonic()
            if now >= min(due):
                ready = (i for i in range(count) if due[i] <= now + TIE)
                turn = min(ready, key=lambda i: due[i] + spare[i])
                controller = self.controllers[turn]
                controller.step()
                if self._trace is not None:
                    self._trace.write(bytes([turn]) + controller.trace())
                if self._reset_between_runs:
                    self._reset_when_idle(now)
                due[turn] += controller.period
                late = now - due[turn] if now - due[turn] > MAX_LAG else 0.0
                self.lost += late
                if controller.answer_time > 0.0:
                    late = max(late, time.monotonic() + controller.answer_time - due[turn])
                if late > 0.0:
                    due = [each + late for each in due]
            wait = max(min(due) - time.monotonic(), 0.0)
            frozen = any(c.network.faults.frozen for c in self.controllers)
            if frozen:  # unread data would wake the selector immediately
                time.sleep(min(wait, 0.002))
            for key, _ in self._selector.select(0.0 if frozen else wait):
                key.data()

    def _reset_when_idle(self, now: float) -> None:
        if any(c.in_use for c in self.controllers):
            self._used_at = now
        elif self._used_at is not None and now - self._used_at > IDLE:
            self._used_at = None
            for controller in self.controllers:
                controller.reset()

    def stop(self) -> None:
        self._stop.set()

    def close(self) -> None:
        for controller in self.controllers:
            controller.close()
        self._selector.close()

    def __enter__(self) -> Rack[AnyController]:
        self.open()
        self._thread = threading.Thread(target=self.run, name="emulated-controllers", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self.stop()
        self._thread.join(timeout=5.0)
        self.close()


class SharedPlant(Protocol):
    """Interface of an emulated arm in the physics world that the controllers of a rack share."""

    def set_joint_targets(self, time: float) -> None:
        """Set the joint targets of an emulated arm in the rack's shared world for the next physics step,
        which ends at the world time `time` [s].
        """
        ...

    def follow_reset(self) -> None:
        """Let an emulated arm in the rack continue from its initial state after the shared world was
        reset.
        """
        ...


class SharedWorld:
    """Physics world that several emulated arms share.

    Each plant is driven by its own emulated controller. The plants with the shortest control period advance
    the world, each by an equal part of the period.
    """

    def __init__(self, world: SimWorld):
        self.world = world
        self._plants: list[SharedPlant] = []
        self._periods: list[float] = []
        self._owed = 0.0  # [s]

    def join(self, plant: SharedPlant, period: float) -> None:
        """Add an emulated arm to the shared world of a rack. The arm's controller calls `advance` once per
        period [s].
        """
        self._plants.append(plant)
        self._periods.append(period)

    def reset(self) -> None:
        """Reset all emulated arms of the rack and all objects in the shared world to their initial state."""
        self.world.reset()
        for plant in self._plants:
            plant.follow_reset()

    def advance(self, period: float) -> None:
        """Advance the rack's shared world after a control period [s] of one arm. If n arms have the shortest
        period, each of them advances the world by 1/n of this period; slower arms do not advance the world.

        A remainder of less than one time step is kept for later.
        """
        shortest = min(self._periods)
        if period > shortest:
            return
        self._owed += period / self._periods.count(shortest)
        step = self.world.timestep
        while self._owed >= step - 1e-9:
            for plant in self._plants:
                plant.set_joint_targets(self.world.time + step)
            self.world.step()
            self._owed -= step


class EmulatedKind(Protocol):
    """Interface of one robot kind's emulator, which creates the controllers of a rack: one for each arm of
    this kind in a cell.

    Attributes:
        physics: physics settings that the emulated drives need.
    """

    physics: Mapping[str, Any]

    def make(
        self, group: str, arm: Any, shared: SharedWorld, io: selectors.BaseSelector,
        say: Callable[[str], None],
    ) -> EmulatedController:  # fmt: skip
        """Create an emulated controller for a rack. The controller's ports are still closed.

        Args:
            group: planning group of the arm.
            arm: settings of the arm in the block `real`.
            io: I/O selector of the rack.
            say: receives a line for each event that the operator would see.
        """
        ...


def cell_rack(
    settings: RealSettings, scene: PlanningScene, physics: PhysicsSettings, say: Callable[[str], None],
    trace: BinaryIO | None = None, reset_between_runs: bool = False,
) -> Rack[EmulatedController]:  # fmt: skip
    """Return emulated controllers for all real arms of a cell, which share one physics world.

    The addresses, models and kinds are those of the cell's block `real`.

    Args:
        scene: the cell's scene at the start.
        say: receives a line for each event that an operator would see at a robot.
        trace, reset_between_runs: see `Rack`.
    Raises:
        InputError: a robot kind has no emulator, or a port is in use.
    """
    kinds = {arm.kind: emulated_kinds[arm.kind] for arm in settings.arms.values()}
    needs: dict[str, Any] = {}
    for name, kind in kinds.items():
        if any(needs.get(key, value) != value for key, value in kind.physics.items()):
            raise InputError(f"the emulated {name} needs other physics settings than the other arms")
        needs |= kind.physics
    shared, io = SharedWorld(SimWorld(scene, replace(physics, **needs))), selector()
    rack: Rack[EmulatedController] = Rack([], io, trace, reset_between_runs)
    try:
        for group, arm in settings.arms.items():
            rack.controllers.append(kinds[arm.kind].make(group, arm, shared, io, say))
    except BaseException:
        rack.close()
        raise
    return rack
