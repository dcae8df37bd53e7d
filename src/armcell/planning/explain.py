"""Plan a request and explain what comes of it; inverse kinematics that can be explained, too."""

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
from armcell.planning.explanation import explain_misuse
from armcell.planning.pipeline import plan
from armcell.scene import PlanningScene


def explain(
    scene: PlanningScene, request: PlanRequest | CartesianRequest, seconds: float = 10.0
) -> Explanation:
    """Plan, and say why it fails and what would help; also where the request itself is wrong.

    Args:
        seconds: about the most that the explanation may take, besides the planning itself.
    """
    try:
        if isinstance(request, CartesianRequest):
            return plan_cartesian(scene, request).explain(seconds)
        return plan(scene, request).explain(seconds)
    except InputError as error:
        return explain_misuse(scene, request, error, seconds)


def solve_ik(
    scene: PlanningScene,
    group: str,
    T_world_link: SE3,
    link: str | None = None,
    avoid_collisions: bool = True,
    seed: int = 0,
) -> IKResult:
    """Joint positions that put a link (the group's tip by default) at a pose, near the scene's state.

    Returns:
        SUCCESS with `positions` (n,) of the group; NO_IK_SOLUTION where none is within limits, or each is
        in collision. `explain()` says which, solution by solution, and which pose nearby can be reached.
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
