"""Planning among obstacles that move along known paths.

The planner does not search in time. It tries three motions and proves each one in time: the motion planned
without the obstacles; the same motion after a wait; a motion around the whole swept volume. It does not
find motions that weave between the obstacles.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from armcell.collision.certify_timed import TimedCertificate, certify_timed
from armcell.core import ErrorCode, InputError, JointTrajectory, PlanRequest, PlanResult
from armcell.planning.pipeline import plan
from armcell.scene import MovingObject, PlanningScene
from armcell.timing import delay_trajectory, stationary_trajectory

WAIT_STEP = 0.1  # [s] increment of waits


def plan_around_moving_obstacles(
    scene: PlanningScene,
    request: PlanRequest,
    moving: Sequence[MovingObject],
    start_time: float = 0.0,
    clearance: float = 0.0,
    cancel: threading.Event | None = None,
) -> PlanResult:
    """Plan a motion that is proven to avoid both static obstacles and obstacles whose motion is known.

    Args:
        start_time: start of the motion [s of the obstacles' clock].
        clearance: distance to keep from moving obstacles [m].
    Returns:
        Like `plan`; `evidence["moving"]` is "as planned", "waits" or "around"; the trajectory includes
        `evidence["wait"]` [s]. On failure the evidence has the `contact` and the `time` [s] of the first
        motion.
    """
    began = time.monotonic()
    if not np.isfinite(start_time):
        raise InputError("start_time must be a finite number of seconds")
    names = {item.name for item in moving}
    standing = replace(scene, objects={k: v for k, v in scene.objects.items() if k not in names})
    first = plan(standing, request, cancel)
    if not first.ok or first.trajectory is None:
        return first
    proof = certify_timed(standing, first.trajectory, moving, start_time, clearance)
    if proof.free:
        return _with_strategy(first, "as planned")
    found: list[PlanResult] = []
    deadline = began + request.planning_time
    waited = _waiting(standing, first.trajectory, moving, start_time, clearance, deadline)
    if waited is not None:
        wait, trajectory = waited
        found.append(_with_strategy(replace(first, trajectory=trajectory), "waits", wait))
    around = _around(standing, request, moving, start_time, clearance, first.trajectory.duration, cancel)
    if around is not None:
        found.append(_with_strategy(around, "around"))
    spent = time.monotonic() - began
    if found:
        return replace(min(found, key=_duration), planning_time=spent)
    contact = proof.contact
    text = "" if contact is None else f"{contact.body_a} meets {contact.body_b} at {proof.time:.2f} s; "
    return PlanResult(
        ErrorCode.PLANNING_FAILED,
        f"{text}neither a wait nor a path around the volume that the obstacles sweep is free",
        {"contact": contact, "time": proof.time},
        planner_id=first.planner_id, planning_time=spent,
    )  # fmt: skip


def _with_strategy(result: PlanResult, how: str, wait: float = 0.0) -> PlanResult:
    return replace(result, evidence={**result.evidence, "moving": how, "wait": wait})


def _duration(result: PlanResult) -> float:
    return np.inf if result.trajectory is None else result.trajectory.duration


def _waiting(
    scene: PlanningScene, trajectory: JointTrajectory, moving: Sequence[MovingObject], start_time: float,
    clearance: float, deadline: float,
) -> tuple[float, JointTrajectory] | None:  # fmt: skip
    """Find the shortest wait after which a motion avoids the moving obstacles; return the delayed motion."""
    last = max(float(item.times[-1]) for item in moving)
    standing = stationary_trajectory(trajectory.joint_names, trajectory.positions[0])
    stay: TimedCertificate = certify_timed(scene, standing, moving, start_time, clearance, until=last)
    longest = (last if stay.free else stay.time) - start_time
    steps = int(np.ceil(longest / WAIT_STEP)) if stay.free else int(longest / WAIT_STEP)
    for k in range(1, steps + 1):
        wait = k * WAIT_STEP
        if time.monotonic() > deadline:
            return None
        later = delay_trajectory(trajectory, wait)
        if certify_timed(scene, later, moving, start_time, clearance).free:
            return wait, later
    return None


def _around(
    scene: PlanningScene, request: PlanRequest, moving: Sequence[MovingObject], start_time: float,
    clearance: float, duration: float, cancel: threading.Event | None,
) -> PlanResult | None:  # fmt: skip
    """Plan a motion around the volume that moving obstacles sweep while the motion lasts.

    If this motion fails the certification in time, plan again with a longer sweep.
    """
    for lasts in (1.5 * duration, 4.0 * duration):
        crowded = scene
        for item in moving:
            crowded = crowded.with_object(item.swept(start_time, start_time + lasts))
        padding = max(scene.padding, clearance + 0.01)  # the obstacle protrudes slightly between two copies
        result = plan(crowded.with_padding(padding), request, cancel)
        if not result.ok or result.trajectory is None:
            return None
        if certify_timed(scene, result.trajectory, moving, start_time, clearance).free:
            return result
    return None
