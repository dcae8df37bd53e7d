"""Planners by name: native, OMPL, CHOMP and STOMP. Importing this package registers them."""

from armcell.planning.planners import aorrtc, chomp, est, ompl, prm, rrt_connect, stomp
from armcell.planning.planners.problem import PlannerResult, Problem, sampling_bounds
from armcell.planning.planners.rrt_connect import NativePlanner, NativeResult, simplify

__all__ = [
    "NativePlanner",
    "NativeResult",
    "PlannerResult",
    "Problem",
    "aorrtc",
    "chomp",
    "est",
    "ompl",
    "prm",
    "rrt_connect",
    "sampling_bounds",
    "simplify",
    "stomp",
]
