"""Motion planning: pipeline, planners, goals, constraints, straight lines, diagnosis.

Other packages import from here, from `armcell.planning.planners` (to add or run single planners) and from
`armcell.planning.diagnosis`.
"""

from armcell.planning.adapters import adapter_names
from armcell.planning.arm_clearance import ArmClearance, achievable_arm_clearance
from armcell.planning.cartesian import plan_cartesian, waypoints_by_offsets
from armcell.planning.constraints.evaluation import (
    constraint_errors,
    describe_violations,
    satisfies_constraints,
)
from armcell.planning.diagnosis import (
    IKBranch,
    PoseExplanation,
    explain_invalid_request,
    explain_pose,
    explain_start,
)
from armcell.planning.diagnosis.explain import explain, solve_ik
from armcell.planning.first_compile import prepare_group, warm_up
from armcell.planning.goals.joint_goals import Target, goal_of
from armcell.planning.moving_obstacles import plan_around_moving_obstacles
from armcell.planning.multi_arm import (
    CarriedObject,
    RunningMotion,
    SynchronizedPlan,
    plan_around_moving_arms,
    plan_carry,
    plan_synchronized,
)
from armcell.planning.pilz.generators import synchronized_profile
from armcell.planning.pilz.sequence import plan_sequence
from armcell.planning.pipeline import plan
from armcell.planning.plan_library import LibraryStatistics, PlanLibrary
from armcell.planning.planners.problem import PlannerResult, Problem, sampling_bounds
from armcell.planning.planners.registry import (
    find_planner,
    normalized_planner_id,
    pipelines,
    planner_defaults,
)

__all__ = [
    "ArmClearance",
    "CarriedObject",
    "IKBranch",
    "LibraryStatistics",
    "PlanLibrary",
    "PlannerResult",
    "PoseExplanation",
    "Problem",
    "RunningMotion",
    "SynchronizedPlan",
    "Target",
    "achievable_arm_clearance",
    "adapter_names",
    "constraint_errors",
    "describe_violations",
    "explain",
    "explain_invalid_request",
    "explain_pose",
    "explain_start",
    "find_planner",
    "goal_of",
    "normalized_planner_id",
    "pipelines",
    "plan",
    "plan_around_moving_arms",
    "plan_around_moving_obstacles",
    "plan_carry",
    "plan_cartesian",
    "plan_sequence",
    "plan_synchronized",
    "planner_defaults",
    "prepare_group",
    "sampling_bounds",
    "satisfies_constraints",
    "solve_ik",
    "synchronized_profile",
    "warm_up",
    "waypoints_by_offsets",
]
