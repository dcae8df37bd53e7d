"""What every planner here looks like to the run."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from benchmarks.planning.problems import Problem, Robot

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Result:
    """CPU time of the calling thread [us] and the waypoints (k, dof), None if there are none."""

    plan_us: float
    simplify_us: float = 0.0
    certify_us: float = 0.0
    raw: Array | None = None
    waypoints: Array | None = None

    @property
    def total_us(self) -> float:
        return self.plan_us + self.simplify_us + self.certify_us


class UnsupportedRobot(Exception):
    """The planner has no model of a robot; the text says why."""


class Peer(Protocol):
    """A planner: a robot is loaded once, then each problem is set and planned."""

    name: str

    def load(self, robot: Robot) -> None:
        """Get ready for a robot.

        Raises:
            UnsupportedRobot: the planner only knows other robots.
        """
        ...

    def set_problem(self, problem: Problem) -> None: ...

    def plan(self, seed: int, seconds: float) -> Result:
        """One run with its own shortening; the time limit is wall time."""
        ...


class Stopwatch:
    """CPU time of this thread between calls [us]."""

    def __init__(self) -> None:
        self._last = time.thread_time()

    def __call__(self) -> float:
        now = time.thread_time()
        passed, self._last = (now - self._last) * 1e6, now
        return passed
