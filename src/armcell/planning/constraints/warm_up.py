"""Compiling, or loading from the cache, what path constraints need; at their first use."""

from __future__ import annotations

import logging
import time
from functools import lru_cache

import numpy as np

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import SE3, Box, Constraints, PositionConstraint
from armcell.model import load_robot
from armcell.planning.constraints.description import Manifold
from armcell.planning.constraints.planner import constrained
from armcell.planning.constraints.search import constrained_rrt_connect
from armcell.planning.native.compiling import announce
from armcell.scene import PlanningScene

logger = logging.getLogger(__name__)


@lru_cache(maxsize=1)
def warm_up_constraints() -> float:
    """Have every compiled function for path constraints ready; returns the seconds it took."""
    began = time.monotonic()
    announce("RRTConnect with path constraints", constrained_rrt_connect)
    model = load_robot("parallel_gripper")
    scene, group = PlanningScene.of(model), "gripper"
    finger = next(j.child for j in model.joints.values() if j.name in model.group(group).joint_names)
    anywhere = PositionConstraint(((Box(1.0, 1.0, 1.0), SE3.identity()),), finger)
    checker = KernelChecker(scene, model.group(group).joint_names)
    manifold = Manifold(scene, group, Constraints(positions=(anywhere,)))
    a, b = np.array([0.01]), np.array([0.04])
    manifold.values(a)
    manifold.leaves(np.vstack([a, b]))
    manifold.projected(a, a, b)
    constrained(checker, manifold).plan(a, b[None], np.array([0.0]), np.array([0.05]))
    seconds = time.monotonic() - began
    if seconds > 2.0:
        logger.info("compiled planning with path constraints in %.0f s; it is kept for later runs", seconds)
    return seconds
