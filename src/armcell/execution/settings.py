"""Tolerances and time limits for the execution of a trajectory."""

from __future__ import annotations

from dataclasses import dataclass, fields

from armcell.core.checks import checked, require


@dataclass(frozen=True)
@checked()
class ExecutionSettings:
    """Settings for the execution of a trajectory: tolerances and time limits.

    The start tolerance of 0.01 rad is MoveIt's default.
    """

    start_tolerance: float = 0.01  # [rad or m] between the measured state and the trajectory's start
    path_tolerance: float = 0.1  # [rad or m] tracking error that aborts the motion
    goal_tolerance: float = 0.005  # [rad or m]
    goal_speed: float = 0.02  # [rad/s or m/s] below which the arm counts as at rest
    settle_time: float = 1.0  # [s] to reach the goal after the trajectory's end
    blend_time: float = 0.2  # [s] for blending a moving arm's velocity into the new motion
    stall_time: float = 5.0  # [s] without progress before a motion that the robot plays itself is aborted

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            require(value > 0, f"{field.name} is {value:g}, it must be positive")
