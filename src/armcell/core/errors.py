"""Error codes for failures that can occur in normal use, and exceptions for bad input.

A request that can legitimately fail returns a result with an `ErrorCode`. The exceptions are for errors
that the caller can fix: an unknown name, a broken file, a missing extra.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from enum import IntEnum
from pathlib import Path


class ErrorCode(IntEnum):
    """MoveIt's error codes (moveit_msgs/MoveItErrorCodes). The one misspelled name is kept as MoveIt spells
    it.
    """

    SUCCESS = 1
    FAILURE = 99999
    PLANNING_FAILED = -1
    INVALID_MOTION_PLAN = -2
    MOTION_PLAN_INVALIDATED_BY_ENVIRONMENT_CHANGE = -3
    CONTROL_FAILED = -4
    UNABLE_TO_AQUIRE_SENSOR_DATA = -5
    TIMED_OUT = -6
    PREEMPTED = -7
    START_STATE_IN_COLLISION = -10
    START_STATE_VIOLATES_PATH_CONSTRAINTS = -11
    GOAL_IN_COLLISION = -12
    GOAL_VIOLATES_PATH_CONSTRAINTS = -13
    GOAL_CONSTRAINTS_VIOLATED = -14
    INVALID_GROUP_NAME = -15
    INVALID_GOAL_CONSTRAINTS = -16
    INVALID_ROBOT_STATE = -17
    INVALID_LINK_NAME = -18
    INVALID_OBJECT_NAME = -19
    FRAME_TRANSFORM_FAILURE = -21
    COLLISION_CHECKING_UNAVAILABLE = -22
    ROBOT_STATE_STALE = -23
    SENSOR_INFO_STALE = -24
    COMMUNICATION_FAILURE = -25
    START_STATE_INVALID = -26
    GOAL_STATE_INVALID = -27
    UNRECOGNIZED_GOAL_TYPE = -28
    CRASH = -29
    ABORT = -30
    NO_IK_SOLUTION = -31

    @property
    def ok(self) -> bool:
        return self is ErrorCode.SUCCESS


class ArmcellError(Exception):
    """Base class of all errors that armcell raises. `str()` returns a one-line message."""


class InputError(ArmcellError):
    """Error for invalid input.
    The message names the file, states what is wrong and why, and says how to correct it.
    """

    def __init__(
        self,
        reason: str,
        *,
        file: str | Path | None = None,
        line: int | None = None,
        element: str | None = None,
        hint: str | None = None,
    ):
        self.reason, self.file, self.line, self.element, self.hint = reason, file, line, element, hint
        place = ""
        if file is not None:
            place = f"{file}:{line}: " if line else f"{file}: "
        if element:
            place += f"{element}: "
        super().__init__(f"{place}{reason}" + (f" ({hint})" if hint else ""))


class UnknownNameError(InputError):
    """Error for an unknown name. The message lists the valid names and suggests the most similar one."""

    def __init__(self, kind: str, name: object, known: Iterable[object], **where):
        self.kind, self.name, self.known = kind, name, sorted(map(str, known))  # YAML keys may have any type
        near = difflib.get_close_matches(str(name), self.known, n=1, cutoff=0.6)
        shown = ", ".join(self.known[:30]) + (", ..." if len(self.known) > 30 else "")
        reason = f"unknown {kind} {str(name)!r}; known: {shown or 'none'}"
        super().__init__(reason, hint=f"did you mean {near[0]!r}?" if near else None, **where)


class MissingExtraError(ArmcellError):
    """Error for an optional dependency that is required but not installed."""

    def __init__(self, package: str, extra: str):
        super().__init__(f"{package} is not installed (pip install 'armcell[{extra}]')")
