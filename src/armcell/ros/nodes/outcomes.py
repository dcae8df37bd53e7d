"""Outcomes of move_group's requests: goal states and the error codes of invalid requests."""

from __future__ import annotations

import threading
from typing import Any

from armcell.core import ErrorCode, InputError, Outcome, UnknownNameError
from armcell.ros.actions import ActionOutcome, GoalState
from armcell.ros.nodes.motion_queue import MotionHandle


def wait_for_outcome(work: MotionHandle, cancel: threading.Event) -> Outcome:
    """Wait for the outcome of a move_group motion. If `cancel` is set, the motion stops."""
    while not work.wait(0.01):
        if cancel.is_set():
            work.cancel.set()
    return work.outcome()


def goal_state(outcome: Outcome, result: Any) -> ActionOutcome:
    """Convert the outcome of a move_group goal to the final state of the goal: SUCCEEDED, PREEMPTED or
    ABORTED (any other failure).
    """
    state = GoalState.SUCCEEDED if outcome.ok else GoalState.ABORTED
    if outcome.code is ErrorCode.PREEMPTED:
        state = GoalState.PREEMPTED
    return ActionOutcome(state, result, outcome.message or outcome.code.name)


def request_code(request: Any, error: InputError) -> ErrorCode:
    """Return the error code that is the outcome of an invalid planning request to move_group.

    move_group returns FAILURE for unknown names, except that an unknown group and a missing goal have their
    own codes.
    """
    if isinstance(error, UnknownNameError) and error.kind == "planning group":
        return ErrorCode.INVALID_GROUP_NAME
    if not request.goal_constraints or "no constraints" in str(error):
        return ErrorCode.INVALID_GOAL_CONSTRAINTS
    return ErrorCode.FAILURE


def unknown_name_code(error: InputError, otherwise: ErrorCode) -> ErrorCode:
    """Return the error code that is the outcome of a move_group request with an unknown name, such as the
    name of a frame, link or object.

    Args:
        error: the error.
        otherwise: code for any other error.
    """
    kind = error.kind if isinstance(error, UnknownNameError) else ""
    known = {
        "frame": ErrorCode.FRAME_TRANSFORM_FAILURE,
        "link": ErrorCode.INVALID_LINK_NAME,
        "joint": ErrorCode.INVALID_ROBOT_STATE,
        "planning group": ErrorCode.INVALID_GROUP_NAME,
        "object": ErrorCode.INVALID_OBJECT_NAME,
        "attached object": ErrorCode.INVALID_OBJECT_NAME,
    }
    return known.get(kind, otherwise)
