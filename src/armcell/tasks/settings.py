"""Settings of tasks: speeds per stage, distances and numbers of attempts."""

from __future__ import annotations

from dataclasses import dataclass

from armcell.core.checks import checked, require
from armcell.execution import ExecutionSettings
from armcell.grasping import POSE_ERROR
from armcell.planning import find_planner

_POSITIVE = (
    "approach_distance",
    "least_approach",
    "lift_distance",
    "lower_distance",
    "retreat_distance",
    "gripper_timeout",
    "planning_time",
    "planning_budget",
    "lost_after",
    "placement_tolerance",
    "contact_force",
)


@dataclass(frozen=True)
@checked()
class Speed:
    """Speed setting for a task's motions: scaling of velocity and acceleration relative to the joint limits,
    in (0, 1].
    """

    velocity: float
    acceleration: float

    def __post_init__(self) -> None:
        for name in ("velocity", "acceleration"):
            value = getattr(self, name)
            require(0 < value <= 1, f"{name} share is {value:g}, it must be in (0, 1]")


@dataclass(frozen=True)
@checked()
class TaskSettings:
    """Settings of tasks that pick and place objects."""

    free: Speed = Speed(0.6, 0.25)  # empty hand, away from objects
    carry: Speed = Speed(0.4, 0.15)  # with a held object
    near: Speed = Speed(0.15, 0.1)  # approach, lift, lower, retreat
    approach_distance: float = 0.10  # [m] pre-grasp to grasp
    lift_distance: float = 0.12  # [m]
    lower_distance: float = 0.08  # [m] pre-place to place
    retreat_distance: float = 0.10  # [m]
    pose_error: float = POSE_ERROR  # [m] by which an object may be beside its believed pose unnoticed
    contact_force: float = 15.0  # [N] on the hand that stops an approach, if the driver measures forces
    release_margin: float = 0.02  # [m] opening beyond the object's width
    grasp_settle: float = 0.3  # [s] pause after closing, before the arm moves
    release_settle: float = 0.3  # [s] pause after opening
    gripper_timeout: float = 3.0  # [s] of simulated time for a gripper motion
    lost_after: float = 0.1  # [s] without grip force until a held object counts as lost
    placement_tolerance: float = 0.005  # [m] a cell's task fails if an object rests further from its goal
    attempts: int = 3  # attempts of a pick, each with another grasp
    max_candidates: int = 40  # grasps or placements evaluated per attempt
    prove_grasps: int = 0  # reachable grasps tested in physics before the choice; 0: no physics
    proof_trials: int = 8  # trials per grasp
    least_approach: float = 0.03  # [m] minimum of the four distances above, if the arm does not reach farther
    planning_time: float = 5.0  # [s of CPU time] per motion
    planner_id: str = "RRTConnect"
    planning_budget: float = 20.0  # [s of CPU time] for all motions of one pick or place together
    solutions: int = 1  # complete plans to compare; 1: take the first
    planning_threads: int = 1  # candidates evaluated in parallel; plans do not depend on it
    cost: str = "duration"  # cost term: duration, path_length, clearance, planning_time
    execution: ExecutionSettings = ExecutionSettings()

    def __post_init__(self) -> None:
        for name in _POSITIVE:
            require(getattr(self, name) > 0, f"{name} is {getattr(self, name):g}, it must be positive")
        for name in ("pose_error", "release_margin", "grasp_settle", "release_settle"):
            require(getattr(self, name) >= 0, f"{name} is {getattr(self, name):g}, it must not be negative")
        require(self.prove_grasps >= 0, f"prove_grasps is {self.prove_grasps}, it must not be negative")
        for name in ("attempts", "max_candidates", "proof_trials", "solutions", "planning_threads"):
            require(getattr(self, name) >= 1, f"{name} is {getattr(self, name)}, it must be at least 1")
        find_planner("", self.planner_id)
