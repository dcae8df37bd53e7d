"""What path? Planners, the pipeline around them, Cartesian motions."""

from armcell.planning.cartesian import plan_cartesian
from armcell.planning.explain import Branch, PoseExplanation, explain_pose
from armcell.planning.pipeline import plan
from armcell.planning.problem import Answer, Problem, normalized_planner_id, planners

__all__ = [
    "Answer",
    "Branch",
    "PoseExplanation",
    "Problem",
    "explain_pose",
    "normalized_planner_id",
    "plan",
    "plan_cartesian",
    "planners",
]
