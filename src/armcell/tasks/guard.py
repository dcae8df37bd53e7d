"""Whether a running motion may go on: looked at again whenever the planning scene is changed."""

from __future__ import annotations

import threading
from collections.abc import Callable, Container
from dataclasses import replace
from typing import Any, Protocol, TypeVar

from armcell.collision.crossing import Crossing, crossing, passed_at
from armcell.core import ErrorCode, ExecutionResult, JointTrajectory, Outcome
from armcell.scene import PlanningScene

Result = TypeVar("Result", Outcome, ExecutionResult)

CHANGED = ErrorCode.MOTION_PLAN_INVALIDATED_BY_ENVIRONMENT_CHANGE
"""How a motion ends that something has come across; what is planned then goes around it."""


class Guarded(Protocol):
    """A cell in which something moves."""

    @property
    def base(self) -> PlanningScene:
        """The world as planners are to see it, with nothing of it measured: another value after a change."""
        ...

    def scene(self) -> PlanningScene:
        """The same as measured now."""
        ...

    def measured(self) -> Container[str]:
        """Objects whose poses are measured, whatever `base` says of them."""
        ...

    def clock(self) -> float:
        """[s]"""
        ...

    @property
    def keeps_time(self) -> bool:
        """Whether a motion is always as far along as the clock says."""
        ...

    def emit(self, kind: str, text: str, **data: Any) -> None: ...


class PathGuard(threading.Event):
    """A motion's `cancel`: set when the task's own is, or when something has come across the rest of the
    motion. Only objects that are new, changed or moved since it was planned are looked at: what it was to
    touch, it may.

    Made when the motion begins. Asked in the thread that moves the arm, which takes the time of the proof.

    Args:
        planned_in: the scene in which the motion was planned, with the contacts that belong to it; the
            present one where nobody knows.
    """

    def __init__(
        self,
        cell: Guarded,
        trajectory: JointTrajectory,
        planned_in: PlanningScene | None = None,
        cancel: threading.Event | None = None,
    ):
        super().__init__()
        self._cell, self._trajectory, self._cancel = cell, trajectory, cancel
        self._began = cell.clock()
        base = cell.base
        self._allowed = {} if planned_in is None else planned_in.allowed_pairs
        self._first = planned_in
        self._known = base if planned_in is None else None
        self.crossing: Crossing | None = None
        self._text = ""

    def is_set(self) -> bool:
        if self._cancel is not None and self._cancel.is_set():
            return True
        if self.crossing is None and (base := self._cell.base) is not self._known:
            self._look(base)
        return self.crossing is not None

    def judged(self, result: Result) -> Result:
        """How the motion ended, given how whoever moved the arm says that it did."""
        found = self.crossing
        if found is None or result.code is not ErrorCode.PREEMPTED:
            return result
        evidence = {**result.evidence, "object": found.object, "contact": found.contact}
        return replace(result, code=CHANGED, message=self._text, evidence=evidence)

    def _look(self, base: PlanningScene) -> None:
        before, told = (self._known, ()) if self._first is None else (self._first, self._cell.measured())
        assert before is not None
        self._known, self._first = base, None
        names = came(before, base, told)
        if not names:
            return
        scene = self._cell.scene()
        scene = replace(scene, allowed_pairs={**self._allowed, **scene.allowed_pairs})
        motion, elapsed = self._trajectory, self._cell.clock() - self._began
        if self._cell.keeps_time:
            passed = elapsed
        else:
            passed = passed_at(motion, scene.state.reindexed(motion.joint_names).positions, elapsed)
        found = crossing(scene, motion, passed, names)
        if found is not None:
            self.crossing = found
            what = f" ({found.contact.describe()})" if found.contact is not None else ""
            self._text = (
                f"{found.object!r} has come across the rest of the motion, {found.time - passed:.2f} s ahead"
                f"{what}: stopped; plan again"
            )
            self._cell.emit("stop", self._text, object=found.object)


def came(before: PlanningScene, now: PlanningScene, measured: Container[str] = ()) -> list[str]:
    """Objects in the world that are new since before, of another shape, or elsewhere and not `measured`."""
    found = []
    for name, item in now.objects.items():
        was = before.objects.get(name)
        if was is item:
            continue
        held = before.attached.get(name)
        known = held.object if was is None and held is not None else was
        same = known is not None and known.shapes is item.shapes
        if same and was is not None and name not in measured:
            same = was.T_world_object.isclose(item.T_world_object)
        if not same:
            found.append(name)
    return found


def guarded(
    cell: Guarded,
    trajectory: JointTrajectory,
    cancel: threading.Event | None,
    move: Callable[[threading.Event], Result],
    planned_in: PlanningScene | None = None,
) -> Result:
    """Move along a trajectory, with a guard as the motion's `cancel`."""
    guard = PathGuard(cell, trajectory, planned_in, cancel)
    return guard.judged(move(guard))
