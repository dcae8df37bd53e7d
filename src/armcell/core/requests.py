"""What can be asked of a planner."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from armcell.core.checks import checked
from armcell.core.constraints import Constraints
from armcell.core.joints import JointState
from armcell.core.transforms import SE3


@dataclass(frozen=True, eq=False)
@checked()
class JointGoal:
    """Joint positions to reach; joints not named stay where they are.

    The positions themselves are taken where they can be; else others within the tolerance. With `turns`, a
    joint may also end whole turns away: as near to the start as its limits allow.
    """

    state: JointState
    tolerance: float = 1e-4  # [rad or m], of each joint that is named
    turns: bool = False


@dataclass(frozen=True, eq=False)
@checked()
class PoseGoal:
    """A pose of a link (the group's tip by default) in the world frame.

    The pose itself is taken where it can be; else one within the tolerances: a ball around the position, and
    rotations by less than an angle, or by less than three about the axes of the wanted orientation.
    """

    T_world_link: SE3
    link: str | None = None  # also an attached object
    position_tolerance: float = 1e-4  # [m]
    orientation_tolerance: float | tuple[float, float, float] = 1e-3  # [rad]; pi or more: any


@dataclass(frozen=True)
class NamedGoal:
    """A named state of the group (SRDF group_state)."""

    name: str


@dataclass(frozen=True, eq=False)
class ConstraintGoal:
    """Any state that keeps to all of these: position only, orientation only, a region, joint ranges."""

    constraints: Constraints


Corner = tuple[float, float, float]
Goal = JointGoal | PoseGoal | NamedGoal | ConstraintGoal

ADAPTERS = ("fix_start_state_bounds", "resolve_constraint_frames", "timing", "validation")
"""What is done around a planner where a request does not say otherwise."""


@dataclass(frozen=True, eq=False)
@checked()
class PlanRequest:
    """A free-space motion of one group. Defaults are MoveIt's where it has one."""

    group: str
    goals: tuple[Goal, ...]  # any one of them will do
    start: JointState | None = None  # the scene's state where None; joints not named keep the scene's
    planner_id: str = "RRTConnect"
    pipeline_id: str = "native"
    planning_time: float = 5.0  # [s]
    attempts: int = 1  # made side by side, with different seeds; the shortest path is taken
    velocity_scaling: float = 1.0  # (0, 1]
    acceleration_scaling: float = 1.0  # (0, 1]
    seed: int = 0
    torque_limits: bool = False  # keep the URDF's effort limits, with what the robot carries
    jerk_limits: bool = False  # keep the model's jerk limits, exactly on the path (not with torque_limits)
    path_constraints: Constraints = Constraints()  # kept all along the motion
    parameters: Mapping[str, Any] = field(default_factory=dict)  # of the planner, by its own names
    planner_configs: Mapping[str, Any] = field(default_factory=dict)  # an ompl_planning.yaml, as it is read
    workspace: tuple[Corner, Corner] | None = None  # [m] low and high corner; the tip stays in it
    max_cartesian_speed: float | None = None  # [m/s] of `speed_link`
    speed_link: str | None = None  # the group's tip where None; also an attached object
    adapters: tuple[str, ...] = ADAPTERS
    arm_clearance: float = 0.02  # [m] between the arms of a group of several, as far as start and goals allow


@dataclass(frozen=True, eq=False)
@checked()
class CartesianRequest:
    """Straight lines of a link through poses, as compute_cartesian_path."""

    group: str
    waypoints: tuple[SE3, ...]  # T_world_link
    link: str | None = None
    start: JointState | None = None
    max_step: float = 0.005  # [m] between checked poses
    jump_threshold: float = 0.2  # [rad] largest step of a turning joint between two of them; 0: any
    prismatic_jump_threshold: float = 0.05  # [m] the same of a sliding joint; 0: any
    relative_jump_threshold: float = 0.0  # largest step as a multiple of the mean step, as MoveIt's; 0: any
    avoid_collisions: bool = True
    path_constraints: Constraints = Constraints()  # kept all along the line
    velocity_scaling: float = 1.0
    acceleration_scaling: float = 1.0
    max_cartesian_speed: float | None = None  # [m/s]


@dataclass(frozen=True, eq=False)
class SequenceRequest:
    """Motions one after the other; after each a blend radius [m] around its end, 0 where it stops there."""

    items: tuple[tuple[PlanRequest, float], ...]
