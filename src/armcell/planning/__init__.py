"""What path? Planners, the pipeline around them, Cartesian motions."""

from armcell.planning.adapters import adapter_names
from armcell.planning.arms import PairPlan, RunningMotion, plan_beside, plan_together
from armcell.planning.cartesian import plan_cartesian, waypoints_by_offsets
from armcell.planning.constraint_check import constraint_errors, satisfied, violations
from armcell.planning.explain import explain, solve_ik
from armcell.planning.explanation import Branch, PoseExplanation, explain_pose, explain_start
from armcell.planning.industrial.sequence import plan_sequence
from armcell.planning.library import LibraryStatistics, PlanLibrary
from armcell.planning.moving import plan_among_moving
from armcell.planning.native.warm_up import prepare, warm_up
from armcell.planning.pipeline import plan
from armcell.planning.problem import Answer, Problem, find_planner, normalized_planner_id, pipelines
from armcell.planning.targets import Target, goal_of

__all__ = [
    "Answer",
    "Branch",
    "LibraryStatistics",
    "PairPlan",
    "PlanLibrary",
    "PoseExplanation",
    "Problem",
    "RunningMotion",
    "Target",
    "adapter_names",
    "constraint_errors",
    "explain",
    "explain_pose",
    "explain_start",
    "find_planner",
    "goal_of",
    "normalized_planner_id",
    "pipelines",
    "plan",
    "plan_among_moving",
    "plan_beside",
    "plan_cartesian",
    "plan_sequence",
    "plan_together",
    "prepare",
    "satisfied",
    "solve_ik",
    "violations",
    "warm_up",
    "waypoints_by_offsets",
]
