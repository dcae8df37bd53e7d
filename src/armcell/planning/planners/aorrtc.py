"""The anytime planner AORRTC as a planner of the pipeline."""

from __future__ import annotations

from typing import Any

import numpy as np

from armcell.planning.native.anytime import AnytimePlanner, AnytimeSettings
from armcell.planning.native.planner import NativePlanner
from armcell.planning.parameters import settings_of
from armcell.planning.planners.native import stopping, unsolved
from armcell.planning.problem import Answer, Problem, pipelines, settings_makers


@pipelines["native"].register("AORRTC")
def aorrtc(problem: Problem) -> Answer:
    """The shortest path found in all of the time given; `cost_over_time`: (s, rad) of each improvement."""
    planner = AnytimePlanner(NativePlanner(problem.checker), problem.settings or AnytimeSettings())
    with stopping(problem) as stop:
        answer = planner.plan(
            problem.start, np.vstack(problem.goals), problem.lower, problem.upper, problem.seed, stop
        )
    statistics: dict[str, Any] = {
        "iterations": float(answer.iterations),
        "nodes": float(answer.nodes),
        "rounds": float(answer.rounds),
        "cost_over_time": [(seconds, cost) for seconds, _, cost in answer.history],
    }
    if answer.waypoints is not None and not problem.cancel.is_set():
        return Answer(answer.waypoints, "", statistics, simplified=True)
    return unsolved("AORRTC", problem, answer.iterations, answer.closest, statistics)


settings_makers[aorrtc] = settings_of("AORRTC", AnytimeSettings)
