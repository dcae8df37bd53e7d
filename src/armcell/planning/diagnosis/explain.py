"""Planning with an explanation of failures, and inverse kinematics with an explanation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import (
    SE3,
    CartesianRequest,
    ErrorCode,
    Explanation,
    IKResult,
    InputError,
    PlanRequest,
    PoseGoal,
)
from armcell.kinematics import ik_solver
from armcell.planning.cartesian import plan_cartesian
from armcell.planning.diagnosis import explain_invalid_request
from armcell.planning.pipeline import plan
from armcell.scene import PlanningScene


def explain(
    scene: PlanningScene, request: PlanRequest | CartesianRequest, seconds: float = 10.0
) -> Explanation:
    """Plan a request, and if this fails explain why and which changes would help.

    Invalid requests are explained, too.

    Args:
        seconds: approximate time limit of the explanation, besides the planning itself.
    """
    try:
        if isinstance(request, CartesianRequest):
            return plan_cartesian(scene, request).explain(seconds)
        return plan(scene, request).explain(seconds)
    except InputError as error:
        return explain_invalid_request(scene, request, error, seconds)


def solve_ik(
    scene: PlanningScene,
    group: str,
    T_world_link: SE3,
    link: str | None = None,
    avoid_collisions: bool = True,
    seed: int = 0,
) -> IKResult:
    """Find joint positions of a planning group that bring a link (by default, the tip) to a pose.
    If there are none, `explain()` of the result returns the reasons.

    Returns:
        SUCCESS with `positions` (n,) of the group; NO_IK_SOLUTION if no solution is within limits, or all
        are in collision. `explain()` reports each solution, and a reachable pose nearby.
    Raises:
        InputError: unknown group or link, or a pose that is not finite.
    """
    ik = ik_solver(scene.model, group, link)
    free = KernelChecker(scene, ik.joint_names).is_free if avoid_collisions else None
    result = ik.solve(T_world_link, scene.positions, free, np.random.default_rng(seed))
    if result.ok:
        return result
    evidence = {k: v for k, v in result.evidence.items() if k != "invalid"}

    def explainer(seconds: float) -> Explanation:
        request = PlanRequest(group, (PoseGoal(T_world_link, link),), seed=seed)
        found = plan(scene, request).explain(seconds)
        return replace(found, code=ErrorCode.NO_IK_SOLUTION)

    return replace(result, evidence=evidence, explainer=explainer)
