"""Containers of stages, as in MoveIt Task Constructor: serial, alternatives and fallbacks.

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
from armcell.tasks.interfaces import InterfaceCheck, serial, single
from armcell.tasks.search import Branch, PartialSolution, SearchState, Stage, in_order, solutions, stage_types


@stage_types.register("serial")
@dataclass(frozen=True, eq=False)
class Serial:
    """Container that runs its stages in sequence. For example, a pick can be one part of a task."""

    name: str
    stages: tuple[Stage, ...]

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        yield from solutions(self.stages, solution, planning)

    def check_interface(self, have: frozenset[str], scene: PlanningScene | None) -> InterfaceCheck:
        return serial(self.stages, have, scene)


@stage_types.register("alternatives")
@dataclass(frozen=True, eq=False)
@checked()
class Alternatives:
    """Container of alternative stages.
    All of them are planned, and the cheapest solution is proposed first.
    """

    name: str
    stages: tuple[Stage, ...]
    cost: Cost = duration
    most: int = 1  # solutions per alternative that are compared

    def __post_init__(self) -> None:
        _need_some(self.name, self.stages)
        if self.most < 1:
            raise InputError(f"most is {self.most}, it must be at least 1", element=self.name)

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        found = in_order((self._branch(stage, solution) for stage in self.stages), planning)
        yield from sorted(found, key=lambda each: self.cost(each.since(solution)))

    def _branch(self, stage: Stage, solution: PartialSolution) -> Branch:
        return lambda planning: islice(planning.propose(stage, solution), self.most)

    def check_interface(self, have: frozenset[str], scene: PlanningScene | None) -> InterfaceCheck:
        return _either(self.stages, have, scene)


@stage_types.register("fallbacks")
@dataclass(frozen=True, eq=False)
class Fallbacks:
    """Container of fallback stages that are tried one after the other until one has a solution."""

    name: str
    stages: tuple[Stage, ...]

    def __post_init__(self) -> None:
        _need_some(self.name, self.stages)

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        for stage in self.stages:
            found = False
            for proposal in planning.propose(stage, solution):
                found = True
                yield proposal
            if found or planning.should_stop:
                return

    def check_interface(self, have: frozenset[str], scene: PlanningScene | None) -> InterfaceCheck:
        return _either(self.stages, have, scene)


def _need_some(name: str, stages: tuple[Stage, ...]) -> None:
    if not stages:
        raise InputError("a container needs at least one stage", element=name)


def _either(stages: tuple[Stage, ...], have: frozenset[str], scene: PlanningScene | None) -> InterfaceCheck:
    """Check the interfaces of a container's alternative stages, and collect their problems. Later stages may
    use only the data that are available after every alternative.
    """
    results = [single(stage, have, scene) for stage in stages]
    return InterfaceCheck(
        frozenset.intersection(*(each.have for each in results)),
        tuple(p for each in results for p in each.problems),
    )
