"""Lazy depth-first search with backtracking over the alternatives of stages.

A container (`containers.py`) is a stage that has stages; all containers use this search. With
`TaskSettings.planning_threads`, threads evaluate candidates in parallel; results do not depend on the thread
count, because the search takes them in order.
"""

from __future__ import annotations

import inspect
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field, replace
from itertools import chain, islice
from typing import Any, Protocol

from armcell.core import ErrorCode, InputError, Outcome, Registry, UnknownNameError
from armcell.core.checks import checked
from armcell.scene import PlanningScene
from armcell.tasks.context import Rejections
from armcell.tasks.settings import TaskSettings
from armcell.tasks.stage_statistics import StageStatistics
from armcell.tasks.steps import Step

CANCEL_PERIOD = 0.02  # [s] between checks for cancellation while threads evaluate candidates


@dataclass(frozen=True, eq=False)
class PartialSolution:
    """Partial solution in the search for a task's plan: the resulting scene,
    the steps so far, and data for later stages.
    """

    scene: PlanningScene
    steps: tuple[Step, ...] = ()
    data: Mapping[str, Any] = field(default_factory=dict)

    def then(self, *steps: Step, scene: PlanningScene | None = None, **data: Any) -> PartialSolution:
        return replace(self, steps=self.steps + steps, scene=scene or self.scene, data={**self.data, **data})

    def since(self, start: PartialSolution) -> PartialSolution:
        """Return a copy of this partial solution without the steps of `start`, the earlier solution that it
        extends.
        """
        return replace(self, steps=self.steps[len(start.steps) :])


@dataclass
class SearchState:
    """Planning state of one task search, used by all stages: settings, seed, cancellation and rejections."""

    settings: TaskSettings
    seed: int = 0
    cancel: threading.Event = field(default_factory=threading.Event)
    rejections: Rejections = field(default_factory=Rejections)
    failure: Outcome | None = None  # the last failed motion from the start, with code and evidence
    began: float = field(default_factory=time.thread_time)
    spent: float = 0.0  # [s] of the budget used before `began` or by other threads
    threads: int | None = None  # for planning; None: the settings' number
    tallies: dict[tuple[str, ...], StageStatistics] = field(
        default_factory=dict
    )  # by stage names, outermost container first
    within: list[str] = field(default_factory=list)  # names of the running stages, outermost first

    def propose(self, stage: Stage, solution: PartialSolution) -> Iterator[PartialSolution]:
        """Yield the solutions that a stage proposes in the search, and record the stage's calls, proposals
        and time in the stage statistics.
        """
        path = (*self.within, stage.name)
        self.tallies.setdefault(path, StageStatistics(path)).asked += 1
        found = iter(stage.propose(solution, self))
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
            self.tallies[tuple(self.within)].add_rejection(stage, candidate, reason)
        if outcome is not None:  # not `outcome or ...`: a failed outcome is false
            self.failure = outcome

    @property
    def time_left(self) -> float:
        """Return the time [s] left in the budget for planning a task by search, in CPU time of this thread.

        CPU time makes plans independent of the load of the machine.
        """
        return self.settings.planning_budget - self.spent - (time.thread_time() - self.began)

    @property
    def should_stop(self) -> bool:
        """Return whether to give up the search for a task's plan. This is the case if the search is canceled
        or out of time, or if the start state is in collision.
        """
        return (
            self.cancel.is_set()
            or self.time_left <= 0
            or (self.failure is not None and self.failure.code is ErrorCode.START_STATE_IN_COLLISION)
        )

    @property
    def thread_count(self) -> int:
        """Return the number of candidates that the search for a task's plan evaluates in parallel threads."""
        return self.settings.planning_threads if self.threads is None else self.threads

    def fork(self) -> SearchState:
        """Copy the planning state of a task search for another thread,
        so that the copy can be canceled separately.
        """
        return replace(
            self, cancel=threading.Event(), rejections=Rejections(), failure=None, tallies={},
            within=list(self.within), threads=1,
        )  # fmt: skip

    def join(self, fork: SearchState, seconds: float) -> None:
        """Merge the results of a forked search state into this state: rejections, stage statistics, the last
        failure, and the CPU time `seconds` [s].

        Later reports of the fork go directly to this state.
        """
        for stage, candidate, reason in fork.rejections.details:
            self.rejections.add(stage, candidate, reason)
        for path, tally in fork.tallies.items():
            self.tallies.setdefault(path, StageStatistics(path)).add(tally)
        self.failure = fork.failure or self.failure
        self.spent += seconds
        fork.rejections, fork.tallies, fork.within = self.rejections, self.tallies, self.within
        fork.cancel, fork.began, fork.spent = self.cancel, self.began, self.spent


class Stage(Protocol):
    """Interface of a stage in a task search. A stage yields possible extensions of a partial solution, best
    first.

    A stage rejects unusable candidates with a reason. `requires`, `provides` and `consumes` (optional tuples
    of names) declare which data of the solution it reads, adds and removes; `interfaces.py` checks them
    before planning starts.
    """

    @property
    def name(self) -> str: ...

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]: ...


stage_types: Registry[Callable[..., Stage]] = Registry("stage", "armcell.stages")
"""Stage classes by name, for the step `stage` of a cell file's task."""


def make_stage(name: str, values: Mapping[str, Any]) -> Stage:
    """Create a stage for the task search from its entry in a cell file.

    The default of `name` is the stage's own name.

    Raises:
        UnknownNameError: no such stage, or the stage has no such value.
        InputError: a value is missing or not valid.
    """
    make = stage_types[name]
    known = inspect.signature(make).parameters
    for key in values:
        if key not in known:
            raise UnknownNameError(f"value of stage {name!r}", key, known)
    ready = {"name": name, **values} if "name" in known else dict(values)
    missing = [k for k, p in known.items() if p.default is p.empty and k not in ready]
    if missing:
        raise InputError(f"stage {name!r} lacks {', '.join(missing)}")
    return make(**ready)


def solutions(
    stages: Sequence[Stage], start: PartialSolution, planning: SearchState
) -> Iterator[PartialSolution]:
    """Yield complete solutions of a task search lazily,
    so that only as many candidates as needed are evaluated.
    """
    if planning.should_stop:
        return
    if not stages:
        yield start
        return
    branches = (_Continuation(stages[1:], found) for found in planning.propose(stages[0], start))
    yield from in_order(branches, planning)


@dataclass(frozen=True, eq=False)
class _Continuation:
    """Branch of a task search: it extends one partial solution by the remaining stages."""

    stages: Sequence[Stage]
    solution: PartialSolution

    def __call__(self, planning: SearchState) -> Iterator[PartialSolution]:
        return solutions(self.stages, self.solution, planning)


Branch = Callable[[SearchState], Iterator[PartialSolution]]
"""A branch of the search; it yields its solutions lazily."""


def in_order(branches: Iterable[Branch], planning: SearchState) -> Iterator[PartialSolution]:
    """Yield the solutions of several search branches, one branch after the other. Stop early if the search
    for the task's plan should stop, for example after a timeout.

    If `planning` has threads, they search the next branches in parallel.
    """
    left = iter(branches)
    if planning.thread_count > 1:
        two = list(islice(left, 2))
        if len(two) > 1:
            yield from _in_parallel(chain(two, left), planning)
            return
        left = iter(two)  # a single branch: its own branches may use the threads
    for branch in left:
        yield from branch(planning)
        if planning.should_stop:
            return


def _in_parallel(branches: Iterator[Branch], planning: SearchState) -> Iterator[PartialSolution]:
    waiting: deque[_ThreadedBranch] = deque()
    with ThreadPoolExecutor(planning.thread_count, "plan candidates") as threads:
        try:
            while not planning.should_stop:
                while len(waiting) < planning.thread_count and (branch := next(branches, None)) is not None:
                    waiting.append(_ThreadedBranch(branch, planning, threads))
                if not waiting:
                    return
                first = waiting.popleft()
                solution = first.first_for(planning)
                while solution is not None:
                    yield solution
                    solution = next(first.solutions, None)
                planning.failure = first.planning.failure or planning.failure
        finally:
            for threaded in waiting:
                threaded.planning.cancel.set()


class _ThreadedBranch:
    """Branch of a task search whose first solution is computed in a separate thread."""

    def __init__(self, branch: Branch, planning: SearchState, threads: ThreadPoolExecutor):
        self.planning = planning.fork()
        self._left = planning.time_left
        self.solutions = branch(self.planning)
        self._found: Future[tuple[PartialSolution | None, float]] = threads.submit(self._look)

    def _look(self) -> tuple[PartialSolution | None, float]:
        own = self.planning
        own.began = time.thread_time()
        own.spent = own.settings.planning_budget - self._left
        solution = next(self.solutions, None)
        return solution, time.thread_time() - own.began

    def first_for(self, planning: SearchState) -> PartialSolution | None:
        """Wait for the first solution of a search branch.
        After this call, the branch belongs to the caller's thread.
        """
        while not wait((self._found,), CANCEL_PERIOD).done:
            if planning.cancel.is_set():
                self.planning.cancel.set()
        solution, seconds = self._found.result()
        planning.join(self.planning, seconds)
        return solution


def search(stages: Sequence[Stage], start: PartialSolution, planning: SearchState) -> PartialSolution | None:
    """Search through the stages of a task for the first complete solution. If there is none,
    `planning.rejections` contains the reasons.
    """
    return next(solutions(stages, start, planning), None)


@stage_types.register("lookahead")
@dataclass(frozen=True, eq=False)
@checked()
class Lookahead:
    """Stage of a task search that looks ahead: it passes on only
    solutions from which later stages can continue.

    The continuation is discarded. Put this stage as early as possible, so that the search does not plan dead
    ends completely.
    """

    name: str
    stages: tuple[Stage, ...]
    then: Callable[[PartialSolution], PartialSolution] = lambda solution: solution  # predicts the later start
    candidates: int = 8  # evaluated per later stage
    ahead: tuple[str, ...] = ()  # names that `then` provides

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        settings = replace(planning.settings, max_candidates=self.candidates)
        ahead = replace(planning, settings=settings, rejections=Rejections())
        if search(self.stages, self.then(solution), ahead) is not None:
            yield solution
            return
        planning.reject(self.name, solution.data.get("candidate", ""), ahead.rejections.summary())
