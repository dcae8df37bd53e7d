"""Interfaces of the motion guard, which dry-runs motions of real arms before they start.

`twin.TwinGuard` implements it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, JointState, JointTrajectory, Outcome
from armcell.drivers.execution_handle import ExecutionHandle, SetpointHistory
from armcell.drivers.safety import Fault

Array = NDArray[np.float64]


class ExecutionMonitor(Protocol):
    """Interface with which a motion guard monitors a motion that is streamed to a real arm point by point."""

    def record_setpoint(self, clock: float, off: Array) -> None:
        """Record a streamed point, so that the motion guard can compare the point with the dry run.

        Args:
            clock: time of the point on the trajectory [s].
            off: offset of the commanded point from the trajectory (n,).
        """
        ...

    def check(self) -> None: ...

    def end(self, how: str) -> None:
        """End the motion guard's monitoring of a motion. `how` is "done" or the reason why the
        motion failed.
        """
        ...


@dataclass(frozen=True, eq=False)
class ArmSample:
    """Measurement of a real arm, which the motion guard compares with the simulated dry run of the same
    motion.

    Attributes:
        positions: (n,) [rad].
        velocities: (n,) [rad/s].
        efforts: motor currents [A] or joint torques [Nm] (n,); the guard learns their scale.
        clock: progress [s] along the trajectory that the robot plays itself; 0 if it plays none.
        speed_fraction: speed fraction, 0 to 1, to which the speed slider is set.
    """

    positions: Array
    velocities: Array
    efforts: Array
    clock: float
    speed_fraction: float


class GuardedArm(Protocol):
    """Interface through which a motion guard reads a real arm's measurements and sets its speed slider.
    `real.RealArm` implements this interface.
    """

    name: str
    joint_names: tuple[str, ...]

    def sample(self) -> ArmSample: ...

    @property
    def time_of_state(self) -> float: ...  # [s, monotonic] time of the measurement

    @property
    def speed_scaling(self) -> float: ...

    def set_slider(self, fraction: float) -> None: ...


class DryRunSimulation(Protocol):
    """Interface of the simulation in which a motion guard dry-runs motions. Callers use it to declare
    expected contacts and to watch held objects.
    """

    def expect_contact(self, body: str, others: tuple[str, ...], expected: bool) -> None: ...

    def watch_object(self, name: str, supports: tuple[str, ...]) -> None: ...

    def unwatch_object(self, name: str) -> None: ...


class MotionGuard(Protocol):
    """Interface of a motion guard, which dry-runs the motions of real arms and compares the arms with
    the simulation.

    Attributes:
        trips: shortest recent network round trip [s], by arm.
        note: called with (arm name, kind, text) for each action of the guard.
    """

    trips: Mapping[str, Callable[[], float]]
    note: Callable[[str, str, str], None]

    @property
    def simulation(self) -> DryRunSimulation: ...

    @property
    def compares(self) -> bool: ...  # False: motions are dry-run, but not compared while they run

    @property
    def motions(self) -> list[Any]: ...  # recorded motions, while the guard learns

    def check_calibration(self, found: Mapping[str, str]) -> None: ...

    def dry_run(
        self,
        trajectory: JointTrajectory,
        state: JointState,
        poses: Mapping[str, SE3],
        held: Mapping[str, str],
    ) -> Outcome | None: ...

    def monitor(
        self, following: ExecutionHandle, trajectory: JointTrajectory, arms: Iterable[GuardedArm],
        trip: Callable[[Fault], None], sent_for: SetpointHistory | None = None, forced: bool = False,
    ) -> ExecutionHandle: ...  # fmt: skip
