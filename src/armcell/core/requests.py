"""What can be asked of a planner."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from armcell.core.constraints import Constraints
from armcell.core.joints import JointState
from armcell.core.transforms import SE3


@dataclass(frozen=True, eq=False)
class JointGoal:
    """Joint positions to reach; joints not named stay where they are."""

    state: JointState
    tolerance: float = 1e-4  # [rad or m]


@dataclass(frozen=True, eq=False)
class PoseGoal:
    """A pose of a link (the group's tip by default) in the world frame."""

    T_world_link: SE3
    link: str | None = None
    position_tolerance: float = 1e-4  # [m]
    orientation_tolerance: float = 1e-3  # [rad]


@dataclass(frozen=True)
class NamedGoal:
    """A named state of the group (SRDF group_state)."""

    name: str


@dataclass(frozen=True, eq=False)
class ConstraintGoal:
    """Any state that keeps to all of these: position only, orientation only, a region, joint ranges."""

    constraints: Constraints


Goal = JointGoal | PoseGoal | NamedGoal | ConstraintGoal


@dataclass(frozen=True, eq=False)
class PlanRequest:
    """A free-space motion of one group. Defaults are MoveIt's where it has one."""

    group: str
    goals: tuple[Goal, ...]  # any one of them will do
    start: JointState | None = None  # the scene's state where None; joints not named keep the scene's
    planner_id: str = "RRTConnect"
    pipeline_id: str = "native"
    planning_time: float = 5.0  # [s]
    attempts: int = 1
    velocity_scaling: float = 1.0  # (0, 1]
    acceleration_scaling: float = 1.0  # (0, 1]
    seed: int = 0
    torque_limits: bool = False  # keep the URDF's effort limits, with what the robot carries
    jerk_limits: bool = False  # keep the model's jerk limits, exactly on the path (not with torque_limits)
    path_constraints: Constraints = Constraints()  # kept all along the motion
    parameters: Mapping[str, Any] = field(default_factory=dict)  # of the planner, by its own names


@dataclass(frozen=True, eq=False)
class CartesianRequest:
    """Straight lines of a link through poses, as compute_cartesian_path."""

    group: str
    waypoints: tuple[SE3, ...]  # T_world_link
    link: str | None = None
    start: JointState | None = None
    max_step: float = 0.005  # [m] between checked poses
    jump_threshold: float = 0.2  # [rad] largest joint step between two of them; 0: any
    avoid_collisions: bool = True
    velocity_scaling: float = 1.0
    acceleration_scaling: float = 1.0
    max_cartesian_speed: float | None = None  # [m/s]
