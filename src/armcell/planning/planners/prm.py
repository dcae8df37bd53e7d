"""The roadmap planner: one roadmap per robot and group, kept as long as the robot's model."""

from __future__ import annotations

import threading
from weakref import WeakKeyDictionary

import numpy as np

from armcell.model import RobotModel
from armcell.planning.native.planner import NativePlanner
from armcell.planning.native.prm import PRMSettings, Roadmap, plan
from armcell.planning.native.warm_up import warm_up_roadmap
from armcell.planning.parameters import settings_of
from armcell.planning.planners.native import POLL, stopping, unsolved
from armcell.planning.problem import Answer, Problem, first_uses, pipelines, settings_makers

_roadmaps: WeakKeyDictionary[RobotModel, dict[tuple, Roadmap]] = WeakKeyDictionary()
_lock = threading.Lock()


def roadmap_of(
    model: RobotModel, joint_names: tuple[str, ...], settings: PRMSettings = PRMSettings()
) -> Roadmap:
    """The roadmap of a group of this model with these settings; made when it is asked for first."""
    with _lock:
        kept = _roadmaps.setdefault(model, {})
        key = (joint_names, settings)
        if key not in kept:
            kept[key] = Roadmap(len(joint_names), settings)
        return kept[key]


@pipelines["native"].register("PRM")
def prm(problem: Problem) -> Answer:
    """A path over the roadmap, proven free and already shortened. Each query leaves the roadmap richer."""
    roadmap = roadmap_of(problem.checker.model, problem.joint_names, problem.settings or PRMSettings())
    planner = NativePlanner(problem.checker)
    goals = np.vstack(problem.goals)
    with stopping(problem) as stop:
        while not roadmap.lock.acquire(timeout=POLL):
            if stop[0]:
                return unsolved("PRM", problem, 0, None, {})
        try:
            found = plan(
                roadmap, planner, problem.start, goals, problem.lower, problem.upper, problem.seed, stop
            )
        finally:
            roadmap.lock.release()
    statistics = {
        "plan_us": found.plan_s * 1e6,
        "vertices": float(found.vertices),
        "edges": float(found.edges),
        "vertex_checks": float(found.vertex_checks),
        "edge_checks": float(found.edge_checks),
        "iterations": float(found.iterations),
    }
    if found.waypoints is not None:
        return Answer(found.waypoints, "", statistics, simplified=True)
    return unsolved("PRM", problem, found.iterations, found.closest, statistics)


settings_makers[prm] = settings_of("PRM", PRMSettings)
first_uses[prm] = warm_up_roadmap
