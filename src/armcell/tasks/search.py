"""Stages and the search over their alternatives: depth first, lazily, with backtracking."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from armcell.core import ErrorCode, Outcome
from armcell.scene import PlanningScene
from armcell.tasks.context import Rejections
from armcell.tasks.settings import TaskSettings
from armcell.tasks.steps import Step


@dataclass(frozen=True, eq=False)
class Draft:
    """A task planned so far: the scene it would lead to, its steps, what later stages need to know."""

    scene: PlanningScene
    steps: tuple[Step, ...] = ()
    data: Mapping[str, Any] = field(default_factory=dict)

    def then(self, *steps: Step, scene: PlanningScene | None = None, **data: Any) -> Draft:
        return replace(self, steps=self.steps + steps, scene=scene or self.scene, data={**self.data, **data})


@dataclass
class Planning:
    """What stages share while planning: settings, seed, cancel, and the reasons for what was rejected."""

    settings: TaskSettings
    seed: int = 0
    cancel: threading.Event = field(default_factory=threading.Event)
    rejections: Rejections = field(default_factory=Rejections)
    failure: Outcome | None = None  # of the last move from the start that failed, with code and evidence
    began: float = field(default_factory=time.monotonic)

    def reject(self, stage: str, candidate: str, reason: str, outcome: Outcome | None = None) -> None:
        self.rejections.add(stage, candidate, reason)
        if outcome is not None:  # not `outcome or ...`: a failed outcome is false
            self.failure = outcome

    @property
    def time_left(self) -> float:
        """Of the budget for planning [s]."""
        return self.settings.planning_budget - (time.monotonic() - self.began)

    @property
    def hopeless(self) -> bool:
        """No other candidate can help: cancelled, out of time, or the start itself is in collision."""
        return (
            self.cancel.is_set()
            or self.time_left <= 0
            or (self.failure is not None and self.failure.code is ErrorCode.START_STATE_IN_COLLISION)
        )


class Stage(Protocol):
    """Extends a draft in one or more ways, best first. What it cannot use it rejects with a reason."""

    @property
    def name(self) -> str: ...

    def drafts(self, draft: Draft, planning: Planning) -> Iterator[Draft]: ...


def search(stages: Sequence[Stage], start: Draft, planning: Planning) -> Draft | None:
    """The first complete draft, or None with the reasons in `planning.rejections`."""
    if planning.hopeless:
        return None
    if not stages:
        return start
    for draft in stages[0].drafts(start, planning):
        found = search(stages[1:], draft, planning)
        if found is not None or planning.hopeless:
            return found
    return None


@dataclass(frozen=True, eq=False)
class Foresee:
    """Passes on only drafts from which later stages would find a way; nothing of that way is kept.

    Put as early as possible: what has no future is then not planned in full.
    """

    name: str
    stages: tuple[Stage, ...]
    then: Callable[[Draft], Draft] = lambda draft: draft  # what the draft will be when those stages begin
    candidates: int = 8  # that each of them looks at

    def drafts(self, draft: Draft, planning: Planning) -> Iterator[Draft]:
        settings = replace(planning.settings, max_candidates=self.candidates)
        ahead = replace(planning, settings=settings, rejections=Rejections())
        if search(self.stages, self.then(draft), ahead) is not None:
            yield draft
            return
        planning.reject(self.name, draft.data.get("candidate", ""), ahead.rejections.summary())
