"""Compiling, or loading from the cache, before anything is timed."""

from __future__ import annotations

import logging
import time
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.kernel.motion import prove_points
from armcell.kinematics import ik_solver
from armcell.model import RobotModel, load_robot
from armcell.planning.finish import clearance_along
from armcell.planning.native.compiling import announce
from armcell.planning.native.planner import NativePlanner
from armcell.planning.native.prm import Roadmap
from armcell.planning.native.prm import plan as plan_on_roadmap
from armcell.planning.native.roadmap import query
from armcell.scene import PlanningScene
from armcell.timing import BlendedPath, parameterize

logger = logging.getLogger(__name__)

Array = NDArray[np.float64]

BOUNDS = np.array([0.0]), np.array([0.05])  # of the gripper that is planned for


def prepare(scene: PlanningScene, group: str) -> None:
    """Fit and keep what all plans for a group share (covers, groups that can meet), before the first."""
    warm_up()
    KernelChecker(scene, scene.model.group(group).joint_names)
    if scene.model.group(group).tip_link:
        warm_up_ik(scene.model, group)


@lru_cache(maxsize=64)
def warm_up_ik(model: RobotModel, group: str, link: str | None = None) -> None:
    """Have the inverse kinematics of a chain ready; arms that are solved in closed form need another one."""
    ik, home = ik_solver(model, group, link), model.default_positions()
    pose = ik.tree.link_pose(home, ik.tip_link)
    ik.solve(pose, home)
    ik.descend(home.copy(), pose)


@lru_cache(maxsize=1)
def warm_up() -> float:
    """Have every compiled function of the planner ready; returns the seconds it took. Cheap the next time.

    The first time on a machine (or with changed sources) this compiles, later it loads from disk.
    """
    began = time.monotonic()
    checker, a, b = _small_problem()
    checker.is_free(a)
    checker.edge_is_free(a, b)
    checker.certify([a, b])
    NativePlanner(checker).plan(a, b[None], *BOUNDS)
    path = BlendedPath(np.array([[0.01], [0.02], [0.04]]), 0.0)
    path.polyline()
    clearance_along(checker, parameterize(path, checker.joint_names, [0.1], [1.0]))
    seconds = time.monotonic() - began
    if seconds > 2.0:
        logger.info("compiled the planner in %.0f s; it is kept for later runs", seconds)
    return seconds


@lru_cache(maxsize=1)
def warm_up_roadmap() -> None:
    """The same for PRM, at its first use."""
    checker, a, b = _small_problem()
    planner, roadmap, stop = NativePlanner(checker), Roadmap(1), np.zeros(1, np.int64)
    announce("PRM", query)
    plan_on_roadmap(roadmap, planner, a, b[None], *BOUNDS)
    roadmap.grow(checker, *BOUNDS, 1, stop)  # what a query needs that does not go straight
    roadmap.insert(np.vstack([a, b]), True)
    prove_points(checker.handle, np.vstack([a, b]), roadmap.no_room, 0)


def _small_problem() -> tuple[KernelChecker, Array, Array]:
    """A gripper, and two of its positions."""
    model = load_robot("parallel_gripper")
    checker = KernelChecker(PlanningScene.of(model), model.group("gripper").joint_names)
    return checker, np.array([0.01]), np.array([0.04])
