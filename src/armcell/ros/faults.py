"""Faults: failure reasons in ROS results and responses, and a counter for faults in received messages.

A failure never reads as a success. A ROS 1 action result has a number and a status text. ROS 2 messages
carry the text in a field: `error_code.message` in MoveIt 2, `error_string` in FollowJointTrajectory,
`message` in Trigger and SetBool. The counter logs each kind of fault only once.
"""

from __future__ import annotations

import threading
from collections import Counter
from typing import Any

from armcell.core import ErrorCode

SOURCE = "armcell"  # moveit_msgs/MoveItErrorCodes.source
ERROR_CODES = "moveit_msgs/MoveItErrorCodes"
INVALID_GOAL = -1  # control_msgs/FollowJointTrajectoryResult: ros2_control's code for a replaced goal
TEXT_FIELDS = ("error_string", "message", "status_message", "reason")
MORE = "more"  # the shared kind for every new fault beyond the limit


def write_failure(answer: Any, text: str, code: ErrorCode = ErrorCode.FAILURE) -> Any:
    """Write a fault, the reason why a ROS action or service call failed, into the fields of its result or
    response message, and return the changed message.

    A text field changes only if the reason contains its old text, for example if the field is empty. Error
    codes that already state a failure stay unchanged.

    Args:
        answer: a Result or Response message, or a message nested in one; changed in place.
        text: the reason.
        code: error code to set if MoveIt's error code is 0 or SUCCESS.
    """
    if answer._type == ERROR_CODES:
        if answer.val in (0, ErrorCode.SUCCESS):
            answer.val = int(code)
        answer.message = _longer(getattr(answer, "message", ""), text)
        answer.source = getattr(answer, "source", "") or SOURCE
        return answer
    for field in answer._fields:
        value = getattr(answer, field)
        if field in TEXT_FIELDS and isinstance(value, str):
            setattr(answer, field, _longer(value, text))
        elif field == "error_code" and isinstance(value, int):
            answer.error_code = value or INVALID_GOAL
        elif field in ("error_code", "motion_plan_response", "response"):
            write_failure(value, text, code)
    return answer


def _longer(said: str, text: str) -> str:
    return text if said in text else said


class FaultCounter:
    """Thread-safe counter of faults in received messages. It counts each kind of fault separately.

    Args:
        most: maximum number of distinct kinds. Later kinds share one counter, so that a faulty sender can
            flood neither the log nor the memory.
    """

    def __init__(self, most: int = 100):
        self._most = most
        self._lock = threading.Lock()
        self._counts: Counter[str] = Counter()

    def count(self, kind: str) -> bool:
        """Count a fault in a received message.
        Return whether a fault of this kind occurs for the first time and must be logged.
        """
        with self._lock:
            if kind not in self._counts and len(self._counts) >= self._most:
                kind = MORE
            self._counts[kind] += 1
            return self._counts[kind] == 1

    @property
    def total(self) -> int:
        with self._lock:
            return sum(self._counts.values())
