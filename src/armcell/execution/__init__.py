"""Execution of trajectories: the motion gate, the executor, coupled arms, several programs on one clock."""

from armcell.execution.executor import ExecutionSettings, execute, playing
from armcell.execution.followed import Steps
from armcell.execution.gate import (
    CHANGED,
    NOT_STARTED,
    DriverWorld,
    Executable,
    GuardedMotion,
    MotionGate,
    UngatedMotion,
)

__all__ = [
    "CHANGED",
    "NOT_STARTED",
    "DriverWorld",
    "Executable",
    "ExecutionSettings",
    "GuardedMotion",
    "MotionGate",
    "Steps",
    "UngatedMotion",
    "execute",
    "playing",
]
