"""Compiling, or loading from the cache, before anything is timed."""

from __future__ import annotations

import logging
import time
from functools import lru_cache

import numpy as np

from armcell.collision.kernel.checker import KernelChecker
from armcell.kinematics import ik_solver
from armcell.model import RobotModel, load_robot
from armcell.planning.finish import clearance_along
from armcell.planning.native.planner import NativePlanner
from armcell.scene import PlanningScene
from armcell.timing import BlendedPath, parameterize

logger = logging.getLogger(__name__)


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
    model = load_robot("parallel_gripper")
    scene = PlanningScene.of(model)
    checker = KernelChecker(scene, model.group("gripper").joint_names)
    a, b = np.array([0.01]), np.array([0.04])
    checker.is_free(a)
    checker.edge_is_free(a, b)
    checker.certify([a, b])
    NativePlanner(checker).plan(a, b[None], np.array([0.0]), np.array([0.05]))
    path = BlendedPath(np.array([[0.01], [0.02], [0.04]]), 0.0)
    path.polyline()
    clearance_along(checker, parameterize(path, checker.joint_names, [0.1], [1.0]))
    seconds = time.monotonic() - began
    if seconds > 2.0:
        logger.info("compiled the planner in %.0f s; it is kept for later runs", seconds)
    return seconds
