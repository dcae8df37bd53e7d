"""Compile the planner's kernels, or load them from the cache, before any timed planning."""

from __future__ import annotations

import logging
import time
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.resting import clearance_from_rest
from armcell.kinematics import ik_solver
from armcell.model import RobotModel, load_robot
from armcell.planning.planners.rrt_connect import NativePlanner
from armcell.scene import PlanningScene
from armcell.timing import BlendedPath, parameterize

Array = NDArray[np.float64]

logger = logging.getLogger(__name__)


BOUNDS = np.array([0.0]), np.array([0.05])  # joint limits of the gripper in the warm-up problem


def prepare(scene: PlanningScene, group: str) -> None:
    """Compute what all plans of a group share before the first plan: covers, colliding pairs."""
    warm_up()
    KernelChecker(scene, scene.model.group(group).joint_names)
    if scene.model.group(group).tip_link:
        warm_up_ik(scene.model, group)


@lru_cache(maxsize=64)
def warm_up_ik(model: RobotModel, group: str, link: str | None = None) -> None:
    """Prepare the inverse kinematics of a chain.

    Arms with a closed-form solution use other kernels.
    """
    ik, home = ik_solver(model, group, link), model.default_positions()
    pose = ik.tree.link_pose(home, ik.tip_link)
    ik.solve(pose, home)
    ik.descend(home.copy(), pose)


@lru_cache(maxsize=1)
def warm_up() -> float:
    """Compile all kernels of the default planner.

    Return the seconds it took. Later calls return at once.

    The first call on a machine (or after source changes) compiles; later runs load the kernels from disk.
    """
    began = time.monotonic()
    checker, a, b = small_problem()
    checker.is_free(a)
    checker.edge_is_free(a, b)
    checker.certify([a, b])
    NativePlanner(checker).plan(a, b[None], *BOUNDS)
    path = BlendedPath(np.array([[0.01], [0.02], [0.04]]), 0.0)
    path.polyline()
    clearance_from_rest(checker, parameterize(path, checker.joint_names, [0.1], [1.0]).positions)
    seconds = time.monotonic() - began
    if seconds > 2.0:
        logger.info("compiled the planner in %.0f s; it is kept for later runs", seconds)
    return seconds


def small_problem() -> tuple[KernelChecker, Array, Array]:
    """Build a tiny planning problem for warm-up.

    The checker of a gripper and two of its positions.
    """
    model = load_robot("parallel_gripper")
    checker = KernelChecker(PlanningScene.of(model), model.group("gripper").joint_names)
    return checker, np.array([0.01]), np.array([0.04])
