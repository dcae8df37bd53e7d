"""The engine: hands trials to workers one by one. One that dies is replaced, its trial given to another.

It does not know what a worker is: a process here (`processes.py`) or an actor on a cluster (`cluster.py`).
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any, Generic, TypeVar

from armcell import _interrupts
from armcell.campaigns.spec import CampaignSpec
from armcell.campaigns.trial import Trial, failed
from armcell.core import InputError
from armcell.core.endpoints import Endpoint

TRIES = 3  # of a trial whose worker dies
LIVES = 2000  # trials until a worker is replaced by a fresh one: whatever a library leaks ends with it
PATIENCE = 600.0  # [s] until some worker is ready; compiling for the first time takes minutes
GLANCE = 1.0  # [s] between two looks at what takes too long

Answer = dict[str, Any]
"""{"ready": true} once, when the cell is loaded, or {"cell": why not}; then a row per trial."""


class Worker(ABC):
    """Runs one trial at a time; given as JSON-ready data, answered with `Answer`s through its `Workers`."""

    def __init__(self) -> None:
        self.trial: Trial | None = None
        self.ready = False  # it has loaded the cell
        self.began = 0.0
        self.done = 0

    def give(self, trial: Trial) -> None:
        self.trial, self.began = trial, time.monotonic()
        self.send(asdict(trial))

    @abstractmethod
    def send(self, data: dict[str, Any]) -> None:
        """A trial. One that is dead says so by its answers, not here."""


W = TypeVar("W", bound=Worker)


class Workers(ABC, Generic[W]):
    """Where workers come from. Used in a `with` block, at the end of which none is left.

    Attributes:
        size: how many there shall be.
        help: what to look at when none comes up.
    """

    size: int
    help: str

    @abstractmethod
    def __enter__(self) -> Workers[W]: ...

    @abstractmethod
    def __exit__(self, *exc: object) -> None: ...

    @abstractmethod
    def start(self) -> W:
        """One more."""

    def endpoints(self) -> tuple[Endpoint, ...]:
        """What the workers and what runs them listen on, now."""
        return ()

    @abstractmethod
    def heard(self, seconds: float) -> Iterator[tuple[W, list[Answer] | None]]:
        """What workers have said since; waits so long [s] for the first. None: it is dead."""

    @abstractmethod
    def end(self, worker: W) -> str:
        """Make sure that it is gone. How it ended, in words: "with status 7"."""


class Pool(Generic[W]):
    """Trials for `workers`, which must have been entered."""

    def __init__(self, spec: CampaignSpec, workers: Workers[W]):
        self.spec, self._workers = spec, workers
        self._all: list[W] = [workers.start() for _ in range(workers.size)]
        self._some_ready = time.monotonic()
        self.died = 0  # in a row, as they started

    def _replace(self, worker: W) -> str:
        self._all.remove(worker)
        how = self._workers.end(worker)
        self._all.append(self._workers.start())
        return how

    def _died_at_start(self, how: str) -> None:
        """
        Raises:
            InputError: too many in a row.
        """
        self.died += 1
        if self.died >= TRIES * self._workers.size:
            raise InputError(f"workers end {how} as they start", cure=self._workers.help)

    def _look_for_ready_ones(self) -> None:
        """
        Raises:
            InputError: for too long there is none.
        """
        if any(worker.ready for worker in self._all):
            self._some_ready = time.monotonic()
        elif time.monotonic() - self._some_ready > PATIENCE:
            raise InputError(f"no worker is ready after {PATIENCE:g} s", cure=self._workers.help)

    def run(self, trials: Iterator[Trial]) -> Iterator[dict[str, Any]]:
        """The rows of trials as they finish, each trial's exactly once.

        Raises:
            InputError: no worker comes up.
        """
        again: list[Trial] = []
        tries: dict[int, int] = {}
        ahead = next(trials, None)

        def give(worker: W) -> None:
            nonlocal ahead
            if not worker.ready or worker.trial is not None:
                return
            if again:
                worker.give(again.pop())
            elif ahead is not None:
                worker.give(ahead)
                ahead = next(trials, None)

        while True:
            for worker in self._all:
                give(worker)
            if ahead is None and not again and all(worker.trial is None for worker in self._all):
                return
            self._look_for_ready_ones()
            _interrupts.check()
            for worker, answers in self._workers.heard(GLANCE):
                if answers is None:
                    trial, how = worker.trial, self._replace(worker)
                    if not worker.ready:
                        self._died_at_start(how)
                    if trial is None:
                        continue
                    tries[trial.number] = tries.get(trial.number, 0) + 1
                    if tries[trial.number] < TRIES:
                        again.append(trial)
                    else:
                        yield failed(trial, "CRASHED", f"its process ended {TRIES} times, at last {how}")
                    continue
                for row in answers:
                    if "ready" in row:
                        worker.ready, self.died = True, 0
                        continue
                    if "cell" in row:  # that it cannot load
                        raise InputError(
                            f"a worker says: {row['cell']}", cure="was the cell changed just now?"
                        )
                    worker.trial = None
                    worker.done += 1
                    if worker.done >= LIVES:
                        self._replace(worker)
                    else:
                        give(worker)  # first: it works on while the row is kept and told
                    yield row
            for worker in list(self._all):
                late = time.monotonic() - worker.began
                if worker.trial is not None and late > self.spec.trial_seconds:
                    trial = worker.trial
                    self._replace(worker)
                    yield failed(trial, "TRIAL_TIMED_OUT", f"not over after {self.spec.trial_seconds:g} s")
