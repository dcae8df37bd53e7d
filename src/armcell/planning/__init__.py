"""What path? Planners, the pipeline around them, Cartesian motions."""

from armcell.planning.cartesian import plan_cartesian
from armcell.planning.explain import explain, solve_ik
from armcell.planning.explanation import Branch, PoseExplanation, explain_pose, explain_start
from armcell.planning.native.warm_up import prepare, warm_up
from armcell.planning.pipeline import plan
from armcell.planning.problem import Answer, Problem, find_planner, normalized_planner_id, pipelines

__all__ = [
    "Answer",
    "Branch",
    "PoseExplanation",
    "Problem",
    "explain",
    "explain_pose",
    "explain_start",
    "find_planner",
    "normalized_planner_id",
    "pipelines",
    "plan",
    "plan_cartesian",
    "prepare",
    "solve_ik",
    "warm_up",
]
