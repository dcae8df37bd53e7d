"""Numbers of a task: speeds per stage, distances, how often to try."""

from __future__ import annotations

from dataclasses import dataclass

from armcell.control import ExecutionSettings


@dataclass(frozen=True)
class Speed:
    """Shares of the joint limits, (0, 1]."""

    velocity: float
    acceleration: float


@dataclass(frozen=True)
class TaskSettings:
    """Settings of pick and place."""

    free: Speed = Speed(0.6, 0.25)  # empty, away from everything
    carry: Speed = Speed(0.4, 0.15)  # with an object
    near: Speed = Speed(0.15, 0.1)  # approach, lift, lower, retreat
    approach_distance: float = 0.10  # [m] pre-grasp to grasp
    lift_distance: float = 0.12  # [m]
    lower_distance: float = 0.08  # [m] pre-place to place
    retreat_distance: float = 0.10  # [m]
    release_margin: float = 0.02  # [m] the fingers open this much wider than the object
    grasp_settle: float = 0.3  # [s] after closing, before anything moves
    release_settle: float = 0.3  # [s] after opening
    gripper_timeout: float = 3.0  # [s] of simulated time for a gripper motion
    attempts: int = 3  # of a whole pick, with another grasp each time
    max_candidates: int = 40  # of grasps or placements looked at per attempt
    planning_time: float = 5.0  # [s] per motion
    planner_id: str = "RRTConnect"
    execution: ExecutionSettings = ExecutionSettings()
