"""Execution of trajectories: motion gate, executor, coupled arms, cooperative scheduler."""

from armcell.execution.admittance import Admittance, AdmittanceSettings
from armcell.execution.executor import ExecutionSteps, execute, execute_coupled, execution_steps
from armcell.execution.motion_gate import (
    NOT_STARTED,
    SCENE_INVALIDATED,
    DriverWorld,
    Executable,
    GuardedMotion,
    MotionGate,
    UngatedMotion,
)
from armcell.execution.scheduler import ArmDriver, CooperativeScheduler, run_cooperatively
from armcell.execution.settings import ExecutionSettings

__all__ = [
    "NOT_STARTED",
    "SCENE_INVALIDATED",
    "Admittance",
    "AdmittanceSettings",
    "ArmDriver",
    "CooperativeScheduler",
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
    "run_cooperatively",
]
