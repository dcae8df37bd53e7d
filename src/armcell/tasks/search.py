"""Stages and the search over their alternatives: depth first, lazily, with backtracking.

A container (`containers.py`) is a stage that has stages; all of them search with what is here. With
`TaskSettings.planning_threads` candidates are gone into at once, each by a thread of its own; what is found
is the same, for they are taken in their order.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field, replace
from itertools import chain, islice
from typing import Any, Protocol

from armcell.core import ErrorCode, Outcome
from armcell.core.checks import checked
from armcell.scene import PlanningScene
from armcell.tasks.context import Rejections
from armcell.tasks.failures import Tally
from armcell.tasks.settings import TaskSettings
from armcell.tasks.steps import Step

CANCEL_LOOK = 0.02  # [s] between two looks whether a task is cancelled whose candidates are gone into at once


@dataclass(frozen=True, eq=False)
class Draft:
    """A task planned so far: the scene it would lead to, its steps, what later stages need to know."""

    scene: PlanningScene
    steps: tuple[Step, ...] = ()
    data: Mapping[str, Any] = field(default_factory=dict)

    def then(self, *steps: Step, scene: PlanningScene | None = None, **data: Any) -> Draft:
        return replace(self, steps=self.steps + steps, scene=scene or self.scene, data={**self.data, **data})

    def since(self, start: Draft) -> Draft:
        """This draft with only the steps that came after an earlier one."""
        return replace(self, steps=self.steps[len(start.steps) :])


@dataclass
class Planning:
    """What stages share while planning: settings, seed, cancel, and the reasons for what was rejected."""

    settings: TaskSettings
    seed: int = 0
    cancel: threading.Event = field(default_factory=threading.Event)
    rejections: Rejections = field(default_factory=Rejections)
    failure: Outcome | None = None  # of the last move from the start that failed, with code and evidence
    began: float = field(default_factory=time.thread_time)
    spent: float = 0.0  # [s] of the budget before `began`, or by other threads
    threads: int | None = None  # that may plan for this; None: as the settings say
    tallies: dict[tuple[str, ...], Tally] = field(default_factory=dict)  # by names, containers first
    within: list[str] = field(default_factory=list)  # names of the stages at work just now, outermost first

    def drafts(self, stage: Stage, draft: Draft) -> Iterator[Draft]:
        """What a stage makes of a draft, counted for the table of stages."""
        path = (*self.within, stage.name)
        self.tallies.setdefault(path, Tally(path)).asked += 1
        found = iter(stage.drafts(draft, self))
        while True:
            self.within.append(stage.name)
            began = time.perf_counter()
            try:
                extended = next(found, None)
            finally:
                self.tallies[path].seconds += time.perf_counter() - began
                self.within.pop()
            if extended is None:
                return
            self.tallies[path].passed += 1
            yield extended

    def reject(self, stage: str, candidate: str, reason: str, outcome: Outcome | None = None) -> None:
        self.rejections.add(stage, candidate, reason)
        if self.within:
            self.tallies[tuple(self.within)].rejected(stage, candidate, reason)
        if outcome is not None:  # not `outcome or ...`: a failed outcome is false
            self.failure = outcome

    @property
    def time_left(self) -> float:
        """Of the budget for planning [s of this thread's CPU time: a machine that other programs fill plans
        later, not less]."""
        return self.settings.planning_budget - self.spent - (time.thread_time() - self.began)

    @property
    def hopeless(self) -> bool:
        """No other candidate can help: cancelled, out of time, or the start itself is in collision."""
        return (
            self.cancel.is_set()
            or self.time_left <= 0
            or (self.failure is not None and self.failure.code is ErrorCode.START_STATE_IN_COLLISION)
        )

    @property
    def at_once(self) -> int:
        """How many candidates are gone into at one time."""
        return self.settings.planning_threads if self.threads is None else self.threads

    def branch(self) -> Planning:
        """For another thread, which can be cancelled by itself."""
        return replace(
            self, cancel=threading.Event(), rejections=Rejections(), failure=None, tallies={},
            within=list(self.within), threads=1,
        )  # fmt: skip

    def join(self, branch: Planning, seconds: float) -> None:
        """Take over what a branch has told, and the CPU time [s] that it took; from here on it tells us."""
        for stage, candidate, reason in branch.rejections.details:
            self.rejections.add(stage, candidate, reason)
        for path, tally in branch.tallies.items():
            self.tallies.setdefault(path, Tally(path)).add(tally)
        self.failure = branch.failure or self.failure
        self.spent += seconds
        branch.rejections, branch.tallies, branch.within = self.rejections, self.tallies, self.within
        branch.cancel, branch.began, branch.spent = self.cancel, self.began, self.spent


class Stage(Protocol):
    """Extends a draft in one or more ways, best first. What it cannot use it rejects with a reason.

    `needs`, `gives` and `takes` (tuples of names, all optional) say what of a draft's data it reads, adds and
    ends; `interfaces.py` checks a task by them before anything is planned.
    """

    @property
    def name(self) -> str: ...

    def drafts(self, draft: Draft, planning: Planning) -> Iterator[Draft]: ...


def solutions(stages: Sequence[Stage], start: Draft, planning: Planning) -> Iterator[Draft]:
    """Complete drafts, one when it is asked for: no stage looks at more candidates than that takes."""
    if planning.hopeless:
        return
    if not stages:
        yield start
        return
    ways = (_Continued(stages[1:], draft) for draft in planning.drafts(stages[0], start))
    yield from in_order(ways, planning)


@dataclass(frozen=True, eq=False)
class _Continued:
    stages: Sequence[Stage]
    draft: Draft

    def __call__(self, planning: Planning) -> Iterator[Draft]:
        return solutions(self.stages, self.draft, planning)


Way = Callable[[Planning], Iterator[Draft]]
"""Looks for drafts when it is asked for them."""


def in_order(ways: Iterable[Way], planning: Planning) -> Iterator[Draft]:
    """The drafts of one way after the other, until all is hopeless; the next few ways are gone into meanwhile
    where `planning` may use threads.
    """
    left = iter(ways)
    if planning.at_once > 1:
        two = list(islice(left, 2))
        if len(two) > 1:
            yield from _at_once(chain(two, left), planning)
            return
        left = iter(two)  # the only one: threads are for what it begins
    for way in left:
        yield from way(planning)
        if planning.hopeless:
            return


def _at_once(ways: Iterator[Way], planning: Planning) -> Iterator[Draft]:
    waiting: deque[_Branch] = deque()
    with ThreadPoolExecutor(planning.at_once, "plan candidates") as threads:
        try:
            while not planning.hopeless:
                while len(waiting) < planning.at_once and (way := next(ways, None)) is not None:
                    waiting.append(_Branch(way, planning, threads))
                if not waiting:
                    return
                branch = waiting.popleft()
                draft = branch.first_for(planning)
                while draft is not None:
                    yield draft
                    draft = next(branch.drafts, None)
                planning.failure = branch.planning.failure or planning.failure
        finally:
            for branch in waiting:
                branch.planning.cancel.set()


class _Branch:
    """One way, whose first draft a thread looks for."""

    def __init__(self, way: Way, planning: Planning, threads: ThreadPoolExecutor):
        self.planning = planning.branch()
        self._left = planning.time_left
        self.drafts = way(self.planning)
        self._found: Future[tuple[Draft | None, float]] = threads.submit(self._look)

    def _look(self) -> tuple[Draft | None, float]:
        own = self.planning
        own.began = time.thread_time()
        own.spent = own.settings.planning_budget - self._left
        draft = next(self.drafts, None)
        return draft, time.thread_time() - own.began

    def first_for(self, planning: Planning) -> Draft | None:
        """Its first draft, once it is there; the rest of it then belongs to the caller's thread."""
        while not wait((self._found,), CANCEL_LOOK).done:
            if planning.cancel.is_set():
                self.planning.cancel.set()
        draft, seconds = self._found.result()
        planning.join(self.planning, seconds)
        return draft


def search(stages: Sequence[Stage], start: Draft, planning: Planning) -> Draft | None:
    """The first complete draft, or None with the reasons in `planning.rejections`."""
    return next(solutions(stages, start, planning), None)


@dataclass(frozen=True, eq=False)
@checked()
class Foresee:
    """Passes on only drafts from which later stages would find a way; nothing of that way is kept.

    Put as early as possible: what has no future is then not planned in full.
    """

    name: str
    stages: tuple[Stage, ...]
    then: Callable[[Draft], Draft] = lambda draft: draft  # what the draft will be when those stages begin
    candidates: int = 8  # that each of them looks at
    ahead: tuple[str, ...] = ()  # names that `then` gives to them

    def drafts(self, draft: Draft, planning: Planning) -> Iterator[Draft]:
        settings = replace(planning.settings, max_candidates=self.candidates)
        ahead = replace(planning, settings=settings, rejections=Rejections())
        if search(self.stages, self.then(draft), ahead) is not None:
            yield draft
            return
        planning.reject(self.name, draft.data.get("candidate", ""), ahead.rejections.summary())
