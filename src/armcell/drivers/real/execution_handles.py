"""Running trajectories on real arms: streamed by a thread, or commanded by the caller."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence

from armcell.core import JointTrajectory
from armcell.drivers.execution_handle import CANCELLED, DONE, RUNNING, ExecutionHandle, SetpointHistory
from armcell.drivers.real.arm import Array, RealArm
from armcell.drivers.safety import Fault


class StreamedExecution:
    """Motion that is streamed to several real arms on one clock. If one arm slows down or stops, all do."""

    def __init__(
        self, arms: Sequence[RealArm], trajectory: JointTrajectory, lead: float,
        fault: Callable[[], Fault | None],
    ):  # fmt: skip
        self._lead = lead  # [s] from sending a point until its due time
        self._arms, self._trajectory, self._fault = arms, trajectory, fault
        self._clock, self._state = 0.0, RUNNING
        self.sent_for = SetpointHistory()
        self.sent_at: list[float] = []  # send times of the points [s, monotonic]
        self._cancel = threading.Event()
        threading.Thread(target=self._stream, name="arm stream", daemon=True).start()

    def _stream(self) -> None:
        period = max(arm.step for arm in self._arms)
        duration, first = self._trajectory.duration, float(self._trajectory.times[0])
        due = time.monotonic()
        names = self._trajectory.joint_names
        columns = [[names.index(n) for n in arm.joint_names] for arm in self._arms]
        while self._fault() is None and not self._cancel.is_set():
            scaling = min(arm.speed_scaling for arm in self._arms)
            q, v, _ = self._trajectory.sample(first + self._clock)
            self.sent_at.append(time.monotonic())
            self.sent_for.record(due + self._lead, self._clock)
            for arm, own in zip(self._arms, columns):
                arm.servo(q[own], v[own] * scaling, due + self._lead)
            if self._clock >= duration:
                self._state = DONE
                return
            late = time.monotonic() - due > self._lead  # then shift the schedule: the arms must not jump
            due = time.monotonic() if late else due + period
            time.sleep(max(due - time.monotonic(), 0.0))
            self._clock = min(self._clock + period * scaling, duration)
        self._state = CANCELLED
        for arm in self._arms:
            arm.cancel()

    def trajectory_time(self) -> float:
        return self.sent_for.at(time.monotonic())[0]

    def state(self) -> str:
        return self._state

    def paused(self) -> bool:
        return any(arm.speed_scaling <= 0.0 for arm in self._arms)

    def cancel(self) -> None:
        self._cancel.set()


class CallerStreamedExecution:
    """Handle of a motion of a real arm that the caller commands point by point.

    Args:
        due: returns the time [s, monotonic] at which the next point is due.
    """

    def __init__(self, due: Callable[[], float]):
        self._due, self._state = due, RUNNING
        self.sent_for = SetpointHistory()
        self.watched: ExecutionHandle = (
            self  # the handle that compares the motion with its twin, if there is one
        )

    def record_setpoint(self, clock: float, off: Array) -> None:
        self.sent_for.record(self._due(), clock, off)

    def check(self) -> None:
        self.watched.trajectory_time()

    def end(self, how: str) -> None:
        self._state = how
        self.watched.state()

    def trajectory_time(self) -> float:
        return self.sent_for.at(time.monotonic())[0]

    def state(self) -> str:
        return self._state

    def paused(self) -> bool:
        return False

    def cancel(self) -> None:
        pass  # the caller stops the motion
