"""Planning requests, their goals, and constraints on motions or goals, as in moveit_msgs/Constraints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from armcell.core.checks import checked
from armcell.core.geometry import Shape
from armcell.core.joints import JointState
from armcell.core.transforms import SE3, SO3

WORLD = "world"
Corner = tuple[float, float, float]
ADAPTERS = ("fix_start_state_bounds", "resolve_constraint_frames", "timing", "validation")
"""Default processing steps before and after the planner, like MoveIt's request adapters."""


@dataclass(frozen=True)
@checked()
class JointConstraint:
    """Constraint in motion requests that keeps a joint within tolerances [rad or m] of a desired position.

    The joint stays between position - tolerance_below and position + tolerance_above.
    """

    joint: str
    position: float
    tolerance_above: float
    tolerance_below: float


@dataclass(frozen=True, eq=False)
@checked()
class PositionConstraint:
    """Constraint in motion requests that keeps a point of a link inside a region, that is, inside at least
    one of the region's shapes.
    """

    region: tuple[tuple[Shape, SE3], ...]  # (shape, T_frame_shape)
    link: str | None = None  # default: the group's tip; also an attached object or a subframe
    point: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m] in the link's frame
    frame: str = WORLD


@dataclass(frozen=True, eq=False)
@checked()
class OrientationConstraint:
    """Constraint in motion requests that keeps the orientation of a link within a tolerance [rad] about each
    axis.

    A tolerance of pi or more frees its axis.

    The error is the rotation from the desired to the current orientation, in the axes of the desired
    orientation: a rotation vector, or intrinsic x-y-z Euler angles (MoveIt's default, singular at 90 deg
    about y).
    """

    rotation: SO3  # R_frame_link
    tolerance: tuple[float, float, float]  # [rad], absolute
    link: str | None = None
    frame: str = WORLD
    parameterization: str = "rotation_vector"  # or "xyz_euler"


@dataclass(frozen=True, eq=False)
@checked()
class VisibilityConstraint:
    """Constraint in motion requests that keeps the view cone from a sensor to a target disc free of the
    robot's links.

    The sensor's own link, the link that carries the disc, and attached objects do not count (as in MoveIt).
    World objects are not checked.
    """

    sensor: str  # link or frame that carries the sensor
    T_frame_target: SE3  # the disc's center; its z axis points to the visible side
    target_radius: float  # [m]
    frame: str = WORLD  # of the target
    T_link_sensor: SE3 = SE3.identity()  # sensor pose in the frame of `sensor`
    view_axis: str = "z"  # viewing axis of the sensor: "z" or "x"
    max_view_angle: float | None = None  # [rad] between viewing axis and disc axis; None: any
    max_range_angle: float | None = None  # [rad] between viewing axis and disc center; None: any
    cone_sides: int = 16  # sides of the pyramid that approximates the cone


@dataclass(frozen=True, eq=False)
@checked()
class Constraints:
    """Set of constraints in motion requests, on the motion or on its goal. All constraints must hold at the
    same time.
    """

    joints: tuple[JointConstraint, ...] = ()
    positions: tuple[PositionConstraint, ...] = ()
    orientations: tuple[OrientationConstraint, ...] = ()
    name: str = ""
    visibilities: tuple[VisibilityConstraint, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.joints or self.positions or self.orientations or self.visibilities)


@dataclass(frozen=True, eq=False)
@checked()
class JointGoal:
    """Goal in motion requests, given as positions of some joints. The other joints keep their positions.

    The planner prefers the exact positions and otherwise uses positions within the tolerance. With `turns`, a
    joint may end whole turns away from its goal, as close to the start as its limits allow.
    """

    state: JointState
    tolerance: float = 1e-4  # [rad or m] of each named joint
    turns: bool = False
    WRITTEN_AS: ClassVar[str] = 'JointGoal(JointState.from_mapping({"joint_1": 0.5}))'


@dataclass(frozen=True, eq=False)
@checked()
class PoseGoal:
    """Goal in motion requests, given as the world pose of a link. By default, the link is the planning
    group's tip.

    The planner prefers the exact pose and otherwise uses one within the tolerances: a ball around the
    position, and a rotation by less than one angle, or less than three angles about the goal's axes.
    """

    T_world_link: SE3
    link: str | None = None  # also an attached object
    position_tolerance: float = 1e-4  # [m]
    orientation_tolerance: float | tuple[float, float, float] = 1e-3  # [rad]; pi or more: any
    WRITTEN_AS: ClassVar[str] = "PoseGoal(SE3.from_xyz(0.4, 0.0, 0.2))"


@dataclass(frozen=True)
@checked()
class NamedGoal:
    """Goal in motion requests, given as a named state of the planning group (group_state in the SRDF)."""

    name: str
    WRITTEN_AS: ClassVar[str] = 'NamedGoal("home")'


@dataclass(frozen=True, eq=False)
@checked()
class ConstraintGoal:
    """Goal in motion requests, given as a region: any robot state that satisfies all constraints reaches the
    goal.

    The constraints limit position, orientation, region and joint ranges.
    """

    constraints: Constraints


Goal = JointGoal | PoseGoal | NamedGoal | ConstraintGoal


@dataclass(frozen=True, eq=False)
@checked()
class PlanRequest:
    """Data type of motion requests: plan a collision-free motion of one planning group.

    The defaults are MoveIt's where MoveIt has one.
    """

    group: str
    goals: tuple[Goal, ...]  # the planner may choose any of them; also a single goal
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

    def __post_init__(self) -> None:
        if isinstance(self.goals, Goal):
            object.__setattr__(self, "goals", (self.goals,))


@dataclass(frozen=True, eq=False)
@checked()
class CartesianRequest:
    """Data type of Cartesian motion requests: move a link through poses on straight lines, as in MoveIt's
    compute_cartesian_path.
    """

    group: str
    waypoints: tuple[SE3, ...]  # T_world_link; also a single pose
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

    def __post_init__(self) -> None:
        if isinstance(self.waypoints, SE3):
            object.__setattr__(self, "waypoints", (self.waypoints,))


@dataclass(frozen=True, eq=False)
class SequenceRequest:
    """Data type of requests for a sequence of motions, with a blend radius [m] at the end of each motion.

    With radius 0, the robot stops there.
    """

    items: tuple[tuple[PlanRequest, float], ...]
