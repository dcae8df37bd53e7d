"""Safety of arms: supervisor that stops all arms after a fault.

The supervisor is not a safety system in the sense of a standard. It runs on an ordinary computer and can fail
with that computer; the robot controllers' own safety functions, emergency stops, fences and a risk assessment
remain necessary.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from armcell.core import ErrorCode, InputError

log = logging.getLogger(__name__)
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Fault:
    """Safety fault of an arm, with its kind, description and remedy. The arm must not move while it has a
    fault.
    """

    arm: str
    kind: str  # "protective stop", "emergency stop", "stale state", ...
    text: str
    hint: str = ""

    @property
    def code(self) -> ErrorCode:
        lost = ("link lost", "stale state", "program ended")
        return ErrorCode.COMMUNICATION_FAILURE if self.kind in lost else ErrorCode.CONTROL_FAILED

    def __str__(self) -> str:
        return f"{self.arm}: {self.text}" + (f" ({self.hint})" if self.hint else "")


def cannot_resume(reason: str, hint: str | None) -> InputError:
    """Return the error for a `resume()` that the safety supervisor refuses,
    with the reason and the remedy.
    """
    if hint and "start armcell" in hint:  # resuming cannot help
        return InputError(f"cannot resume: {reason}", hint=hint)
    return InputError(
        f"cannot resume: {reason}", hint=f"{hint or 'see the pendant'}; then call resume() again"
    )


@dataclass(frozen=True)
class SafetyEvent:
    """Entry in the event log of the safety supervisor."""

    time: float  # [s] monotonic clock
    wall: float  # [s] since the epoch
    arm: str
    kind: str
    text: str


class SupervisedArm(Protocol):
    """Interface of an arm for the safety supervisor, which reads the arm's faults and stops the arm."""

    def fault(self) -> Fault | None:
        """Return the current safety fault of a supervised arm, or None."""
        ...

    def halt(self) -> None:
        """Stop a supervised arm for safety, discard its goals and hold the measured pose.
        The call must not block.
        """
        ...


class Supervisor:
    """Safety supervisor, which stops all arms as soon as one arm has a fault.

    Call `check` often: on every state, and periodically.
    """

    def __init__(self, arms: Mapping[str, SupervisedArm], on_trip: Callable[[Fault], None] | None = None):
        self._arms, self._on_trip = dict(arms), on_trip
        self._lock = threading.RLock()
        self.tripped: Fault | None = None
        self.events: list[SafetyEvent] = []

    def record(self, arm: str, kind: str, text: str) -> None:
        self.events.append(SafetyEvent(time.monotonic(), time.time(), arm, kind, text))
        log.info("safety: %s: %s: %s", arm, kind, text)

    def check(self) -> Fault | None:
        """Let the safety supervisor stop all arms if one of them has a fault.
        Return the latched fault, or None.
        """
        if self.tripped is None:
            for arm in self._arms.values():
                found = arm.fault()
                if found is not None:
                    self.trip(found)
                    break
        return self.tripped

    def trip(self, fault: Fault) -> None:
        """Latch a fault in the safety supervisor and stop every arm.
        Later faults are ignored until `clear` is called.
        """
        with self._lock:
            if self.tripped is not None:
                return
            self.tripped = fault
            self.record(fault.arm, fault.kind, fault.text)
            for name, arm in self._arms.items():
                arm.halt()
                if name != fault.arm:
                    self.record(name, "peer stopped", f"stopped because of {fault.arm}: {fault.kind}")
        if self._on_trip is not None:
            self._on_trip(fault)

    def clear(self) -> None:
        """Clear the fault in the safety supervisor so that the arms can move again.
        Call this only after the operator confirms.

        Raises:
            InputError: an arm still has a fault; the message states the fault and the remedy.
        """
        with self._lock:
            for arm in self._arms.values():
                found = arm.fault()
                if found is not None:
                    raise cannot_resume(f"{found.arm}: {found.text}", found.hint)
            if self.tripped is not None:
                self.record(self.tripped.arm, "resumed", f"after {self.tripped.kind}")
            self.tripped = None
