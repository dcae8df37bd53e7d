"""A motion that was not begun: the robot does not stand where it starts."""

from __future__ import annotations

import numpy as np

from armcell.core import ErrorCode, Explanation, JointState, PlanRequest, Suggestion
from armcell.planning.explanation.changes import Both, change_request
from armcell.scene import PlanningScene

ALIKE = 0.02  # [rad] two positions that mean the same differ by less


def explain_start(measured: JointState, planned: JointState, tolerance: float, code: ErrorCode,
                  message: str, seconds: float = 0.0) -> Explanation:  # fmt: skip
    """Which joints stand elsewhere than a motion starts, by how much, and what to do.

    Args:
        planned: where the motion starts; measured: where the robot is, the same joints.
        tolerance: [rad or m] within which it would begin.
        seconds: not used; nothing has to be searched for.
    """
    off = measured.reindexed(planned.joint_names).positions - planned.positions
    order = np.argsort(-np.abs(off))
    names = [planned.joint_names[k] for k in order if abs(off[k]) > tolerance]
    details = [
        f"{planned.joint_names[k]} is at {measured[planned.joint_names[k]]:.4f}, the motion starts at "
        f"{planned.positions[k]:.4f}: {off[k]:+.4f} off"
        for k in order
        if abs(off[k]) > tolerance
    ]
    turns = np.round(off / (2 * np.pi))
    if turns.any() and np.all(np.abs(off - 2 * np.pi * turns) <= max(tolerance, ALIKE)):
        details.append("the difference is whole turns: the driver counts turns otherwise than the planner")
    elif _looks_like_degrees(measured, planned):
        details.append("the measured positions look like degrees where radians are wanted")
    text = "plan again from where the robot is"
    state = measured.reindexed(planned.joint_names)
    return Explanation(
        code,
        message,
        tuple(details),
        (Suggestion(text, start_from, {"state": state}, float(np.abs(off).max(initial=0.0))),),
        state=state,
        nearest=planned,
        data={"joints": names, "off": dict(zip(planned.joint_names, off.tolist(), strict=True))},
    )


def start_from(scene: PlanningScene, request: PlanRequest, state: JointState) -> Both:
    """The scene as the robot stands now, and the request without a start of its own."""
    return change_request(scene.with_state(state), request, start=None)


def _looks_like_degrees(measured: JointState, planned: JointState) -> bool:
    values = measured.reindexed(planned.joint_names).positions
    return bool(np.abs(values).max(initial=0.0) > 2 * np.pi and np.allclose(
        np.deg2rad(values), planned.positions, atol=ALIKE
    ))  # fmt: skip
