"""Stages and the search over their alternatives: depth first, lazily, with backtracking."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

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

    def reject(self, stage: str, candidate: str, reason: str) -> None:
        self.rejections.add(stage, candidate, reason)


class Stage(Protocol):
    """Extends a draft in one or more ways, best first. What it cannot use it rejects with a reason."""

    @property
    def name(self) -> str: ...

    def drafts(self, draft: Draft, planning: Planning) -> Iterator[Draft]: ...


def search(stages: Sequence[Stage], start: Draft, planning: Planning) -> Draft | None:
    """The first complete draft, or None with the reasons in `planning.rejections`."""
    if planning.cancel.is_set():
        return None
    if not stages:
        return start
    for draft in stages[0].drafts(start, planning):
        found = search(stages[1:], draft, planning)
        if found is not None or planning.cancel.is_set():
            return found
    return None
