"""Execution of trajectories: the motion gate, the executor, coupled arms, several programs on one clock."""

from armcell.execution.executor import ExecutionSteps, execute, execute_coupled, execution_steps
from armcell.execution.gate import (
    CHANGED,
    NOT_STARTED,
    DriverWorld,
    Executable,
    GuardedMotion,
    MotionGate,
    UngatedMotion,
)
from armcell.execution.settings import ExecutionSettings

__all__ = [
    "CHANGED",
    "NOT_STARTED",
    "DriverWorld",
    "Executable",
    "ExecutionSettings",
    "ExecutionSteps",
    "GuardedMotion",
    "MotionGate",
    "UngatedMotion",
    "execute",
    "execute_coupled",
    "execution_steps",
]
