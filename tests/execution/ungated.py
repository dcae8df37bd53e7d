"""The executor's functions for drivers without a cell around them: what they play is proven by nobody."""

from __future__ import annotations

import threading
from typing import Any

from armcell import execution
from armcell.core import ExecutionResult, JointTrajectory
from armcell.execution import ExecutionSettings, ExecutionSteps, UngatedMotion


def execute(
    driver: Any,
    trajectory: JointTrajectory,
    settings: ExecutionSettings = ExecutionSettings(),
    cancel: threading.Event | None = None,
    progress: Any = None,
) -> ExecutionResult:
    return execution.execute(driver, UngatedMotion(trajectory, cancel), settings, progress)


def execution_steps(
    driver: Any,
    trajectory: JointTrajectory,
    settings: ExecutionSettings = ExecutionSettings(),
    cancel: threading.Event | None = None,
) -> ExecutionSteps:
    return execution.execution_steps(driver, UngatedMotion(trajectory, cancel), settings)


def execute_coupled(
    driver: Any, trajectory: JointTrajectory, *args: Any, cancel: threading.Event | None = None, **kwargs: Any
) -> ExecutionResult:
    return execution.execute_coupled(driver, UngatedMotion(trajectory, cancel), *args, **kwargs)
