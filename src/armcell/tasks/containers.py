"""Stages made of stages, after MoveIt Task Constructor's: one after another, side by side, or as a reserve.

Görner, Haschke, Ritter, Zhang, MoveIt! Task Constructor for Task-Level Motion Planning (ICRA 2019).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

from armcell.core import InputError
from armcell.core.checks import checked
from armcell.scene import PlanningScene
from armcell.tasks.costs import Cost, duration
from armcell.tasks.interfaces import Checked, serial, single
from armcell.tasks.search import Draft, Planning, Stage, Way, in_order, solutions


@dataclass(frozen=True, eq=False)
class Serial:
    """Stages one after another under one name: a part of a task, as picking is."""

    name: str
    stages: tuple[Stage, ...]

    def drafts(self, draft: Draft, planning: Planning) -> Iterator[Draft]:
        yield from solutions(self.stages, draft, planning)

    def checked(self, have: frozenset[str], scene: PlanningScene | None) -> Checked:
        return serial(self.stages, have, scene)


@dataclass(frozen=True, eq=False)
@checked()
class Alternatives:
    """Several ways to the same: all are planned, the cheapest comes first."""

    name: str
    stages: tuple[Stage, ...]
    cost: Cost = duration
    most: int = 1  # solutions of each way that are compared

    def __post_init__(self) -> None:
        _need_some(self.name, self.stages)
        if self.most < 1:
            raise InputError(f"most is {self.most}, it must be at least 1", element=self.name)

    def drafts(self, draft: Draft, planning: Planning) -> Iterator[Draft]:
        found = in_order((self._way(stage, draft) for stage in self.stages), planning)
        yield from sorted(found, key=lambda way: self.cost(way.since(draft)))

    def _way(self, stage: Stage, draft: Draft) -> Way:
        return lambda planning: islice(planning.drafts(stage, draft), self.most)

    def checked(self, have: frozenset[str], scene: PlanningScene | None) -> Checked:
        return _either(self.stages, have, scene)


@dataclass(frozen=True, eq=False)
class Fallbacks:
    """Several ways, the preferred one first: another is asked only where those before it found none."""

    name: str
    stages: tuple[Stage, ...]

    def __post_init__(self) -> None:
        _need_some(self.name, self.stages)

    def drafts(self, draft: Draft, planning: Planning) -> Iterator[Draft]:
        for stage in self.stages:
            found = False
            for way in planning.drafts(stage, draft):
                found = True
                yield way
            if found or planning.hopeless:
                return

    def checked(self, have: frozenset[str], scene: PlanningScene | None) -> Checked:
        return _either(self.stages, have, scene)


def _need_some(name: str, stages: tuple[Stage, ...]) -> None:
    if not stages:
        raise InputError("a container without stages leads nowhere", element=name)


def _either(stages: tuple[Stage, ...], have: frozenset[str], scene: PlanningScene | None) -> Checked:
    """What is there afterwards whichever way is taken."""
    ways = [single(stage, have, scene) for stage in stages]
    return Checked(
        frozenset.intersection(*(way.have for way in ways)), tuple(p for way in ways for p in way.problems)
    )
