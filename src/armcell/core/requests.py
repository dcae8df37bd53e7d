"""Planning requests and their goals."""

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
    """Goal of a planning request, given as positions of some joints; the other joints keep their positions.

    The planner prefers the exact positions and otherwise uses positions within the tolerance. With `turns`, a
    joint may end whole turns away from its goal, as close to the start as its limits allow.
    """

    state: JointState
    tolerance: float = 1e-4  # [rad or m] of each named joint
    turns: bool = False


@dataclass(frozen=True, eq=False)
@checked()
class PoseGoal:
    """Goal of a planning request, given as the world pose of a link; by default,
    the link is the planning group's tip.

    The planner prefers the exact pose and otherwise uses one within the tolerances: a ball around the
    position, and a rotation by less than one angle, or less than three angles about the goal's axes.
    """

    T_world_link: SE3
    link: str | None = None  # also an attached object
    position_tolerance: float = 1e-4  # [m]
    orientation_tolerance: float | tuple[float, float, float] = 1e-3  # [rad]; pi or more: any


@dataclass(frozen=True)
class NamedGoal:
    """Goal of a planning request, given as a named state of the planning group (group_state in the SRDF)."""

    name: str


@dataclass(frozen=True, eq=False)
class ConstraintGoal:
    """Goal of a planning request, given as a region:
    any robot state that satisfies all constraints reaches the goal.

    The constraints limit position, orientation, region and joint ranges.
    """

    constraints: Constraints


Corner = tuple[float, float, float]
Goal = JointGoal | PoseGoal | NamedGoal | ConstraintGoal

ADAPTERS = ("fix_start_state_bounds", "resolve_constraint_frames", "timing", "validation")
"""Default processing steps before and after the planner, like MoveIt's request adapters."""


@dataclass(frozen=True, eq=False)
@checked()
class PlanRequest:
    """Request to plan a collision-free motion of one planning group.

    The defaults are MoveIt's where MoveIt has one.
    """

    group: str
    goals: tuple[Goal, ...]  # the planner may choose any of them
    start: JointState | None = None  # default: the scene's state; unnamed joints keep the scene's positions
    planner_id: str = "RRTConnect"
    pipeline_id: str = "native"
    planning_time: float = 5.0  # [s]
    attempts: int = 1  # run in parallel with different seeds; the shortest path wins
    velocity_scaling: float = 1.0  # (0, 1]
    acceleration_scaling: float = 1.0  # (0, 1]
    seed: int = 0
    torque_limits: bool = False  # keep the URDF's effort limits, including attached objects
    jerk_limits: bool = False  # keep the model's jerk limits, exactly on the path (not with torque_limits)
    path_constraints: Constraints = Constraints()  # hold along the whole motion
    parameters: Mapping[str, Any] = field(default_factory=dict)  # the planner's own parameters
    planner_configs: Mapping[str, Any] = field(default_factory=dict)  # a parsed ompl_planning.yaml
    workspace: tuple[Corner, Corner] | None = None  # [m] lower and upper corner; the tip stays inside
    max_cartesian_speed: float | None = None  # [m/s] of `speed_link`
    speed_link: str | None = None  # default: the group's tip; also an attached object
    adapters: tuple[str, ...] = ADAPTERS
    arm_clearance: float = 0.02  # [m] between the arms of a multi-arm group, as far as start and goals allow


@dataclass(frozen=True, eq=False)
@checked()
class CartesianRequest:
    """Request to move a link through poses on straight lines, as in MoveIt's compute_cartesian_path."""

    group: str
    waypoints: tuple[SE3, ...]  # T_world_link
    link: str | None = None
    start: JointState | None = None
    max_step: float = 0.005  # [m] between checked poses
    jump_threshold: float = 0.2  # [rad] largest step of a revolute joint between two poses; 0: any
    prismatic_jump_threshold: float = 0.05  # [m] largest step of a prismatic joint between two poses; 0: any
    relative_jump_threshold: float = 0.0  # largest step as a multiple of the mean step, as in MoveIt; 0: any
    avoid_collisions: bool = True
    path_constraints: Constraints = Constraints()  # hold along the whole line
    velocity_scaling: float = 1.0
    acceleration_scaling: float = 1.0
    max_cartesian_speed: float | None = None  # [m/s]


@dataclass(frozen=True, eq=False)
class SequenceRequest:
    """Request for a sequence of motions, with a blend radius [m] at the end of each motion.

    With radius 0, the robot stops there.
    """

    items: tuple[tuple[PlanRequest, float], ...]
