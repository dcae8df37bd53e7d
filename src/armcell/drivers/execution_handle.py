"""Handle of a trajectory that a robot plays itself, and history of streamed setpoints."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from armcell.core import Outcome

RUNNING, DONE, CANCELLED = "running", "done", "cancelled"  # states of a trajectory


class ExecutionHandle(Protocol):
    """Handle to monitor and cancel a trajectory that the driver executes without further commands from the
    caller.
    """

    def trajectory_time(self) -> float | None:
        """Return the progress [s] of the execution of a trajectory that the robot plays itself. The speed
        slider and pauses slow the progress.

        None if the robot does not report its progress; `state` then returns the outcome at the end.
        """
        ...

    def state(self) -> str | Outcome:
        """Return the execution state of a trajectory that the robot plays itself: "running", "done",
        "cancelled", or the reason why it was aborted.

        An outcome is the robot's own decision, which the joint states need not confirm.
        """
        ...

    def paused(self) -> bool: ...

    def cancel(self) -> None: ...


class SetpointHistory:
    """History from which an execution handle derives the progress of a streamed trajectory. For each
    setpoint, it stores the due time and the setpoint's time on the trajectory.
    """

    KEPT = 200  # points

    def __init__(self) -> None:
        self._points: deque[tuple[float, float, NDArray[np.float64] | None]] = deque(maxlen=self.KEPT)

    def record(self, when: float, clock: float, off: NDArray[np.float64] | None = None) -> None:
        """Record, for the handle of an executed trajectory, a streamed setpoint: the time at which it is due,
        and its time on the trajectory.

        Args:
            when: monotonic time [s] at which the point is due.
            clock: time of the point on the trajectory [s].
            off: offset of the point from the trajectory (n,), or None.
        """
        self._points.append((when, clock, off))

    def at(self, when: float) -> tuple[float, NDArray[np.float64] | None]:
        """For the handle of an executed trajectory, look up the streamed setpoint that is due at a monotonic
        time [s]. Return its time on the trajectory [s] and its offset (n,) from the trajectory.

        Before the first and after the last recorded point, the nearest one applies.
        """
        points = list(self._points)
        if not points:
            return 0.0, None
        k = bisect_left(points, when, key=lambda point: point[0])
        if k == 0 or k == len(points):
            _, clock, off = points[min(k, len(points) - 1)]
            return clock, off
        (t0, c0, _), (t1, c1, off) = points[k - 1], points[k]
        return c0 + (c1 - c0) * (when - t0) / (t1 - t0), off
