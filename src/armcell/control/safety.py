"""The safety supervisor: one arm's trouble stops every arm, and only an explicit call lets them move again.

It is not a safety system in the sense of a standard. It runs on an ordinary computer and can fail with it;
the robot controllers' own safety functions, emergency stops, fences and a risk assessment stay necessary.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from armcell.core import ErrorCode, InputError

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Fault:
    """Why an arm must not move."""

    arm: str
    kind: str  # "protective stop", "emergency stop", "stale state", ...
    text: str
    cure: str = ""

    @property
    def code(self) -> ErrorCode:
        lost = ("link lost", "stale state", "program ended")
        return ErrorCode.COMMUNICATION_FAILURE if self.kind in lost else ErrorCode.CONTROL_FAILED

    def __str__(self) -> str:
        return f"{self.arm}: {self.text}" + (f" ({self.cure})" if self.cure else "")


def cannot_resume(reason: str, cure: str | None) -> InputError:
    """Why arms stay stopped, and what to do before the next `resume()`."""
    if cure and "start armcell" in cure:  # no resume helps
        return InputError(f"cannot resume: {reason}", cure=cure)
    return InputError(
        f"cannot resume: {reason}", cure=f"{cure or 'see the pendant'}; then call resume() again"
    )


@dataclass(frozen=True)
class SafetyEvent:
    """One line of the supervisor's record."""

    time: float  # [s] monotonic clock
    wall: float  # [s] since the epoch
    arm: str
    kind: str
    text: str


class Supervised(Protocol):
    """An arm as the supervisor sees it."""

    def fault(self) -> Fault | None:
        """What is wrong now."""
        ...

    def halt(self) -> None:
        """Stop, forget every goal, take the measured pose for the setpoint. Must not raise or wait."""
        ...


class Supervisor:
    """Watches arms; `check` is to be called often (every state, and by a clock)."""

    def __init__(self, arms: Mapping[str, Supervised], on_trip: Callable[[Fault], None] | None = None):
        self._arms, self._on_trip = dict(arms), on_trip
        self._lock = threading.RLock()
        self.tripped: Fault | None = None
        self.events: list[SafetyEvent] = []

    def record(self, arm: str, kind: str, text: str) -> None:
        self.events.append(SafetyEvent(time.monotonic(), time.time(), arm, kind, text))
        log.info("safety: %s: %s: %s", arm, kind, text)

    def check(self) -> Fault | None:
        """Trip if any arm has a fault; returns what has tripped it, now or before."""
        if self.tripped is None:
            for arm in self._arms.values():
                found = arm.fault()
                if found is not None:
                    self.trip(found)
                    break
        return self.tripped

    def trip(self, fault: Fault) -> None:
        """Stop every arm. Further faults are recorded by the first one's arm only."""
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
        """Let the arms move again, by the operator's word.

        Raises:
            InputError: something is still wrong; says what and what helps.
        """
        with self._lock:
            for arm in self._arms.values():
                found = arm.fault()
                if found is not None:
                    raise cannot_resume(f"{found.arm}: {found.text}", found.cure)
            if self.tripped is not None:
                self.record(self.tripped.arm, "resumed", f"after {self.tripped.kind}")
            self.tripped = None
