"""Scheduler of a campaign's trials, and the local worker processes that run them.

The scheduler gives each worker one trial at a time and replaces workers that die; the trial of a dead
worker goes to another worker. It is independent of the kind of worker: local processes (`Processes`) or
actors on a cluster (`ray_workers.py`).
"""

from __future__ import annotations

import json
import os
import selectors
import subprocess
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any, Generic, TypeVar

from armcell import _interrupts
from armcell._interrupts import unsignaled
from armcell.campaigns.spec import CampaignSpec
from armcell.campaigns.trial import Trial, failed
from armcell.core import InputError
from armcell.core.network_endpoints import Endpoint

TRIES = 3  # attempts for a trial whose worker dies
LIVES = 2000  # trials until a worker is replaced, to bound memory leaks of libraries
PATIENCE = 600.0  # [s] until a worker must be ready; the first compilation takes minutes
GLANCE = 1.0  # [s] between two checks for timeouts

Answer = dict[str, Any]
"""Message of a worker: first {"ready": true}, or {"cell": error} for an invalid cell; then trial rows."""
ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)


class Worker(ABC):
    """Interface of the workers in a trial pool.
    A worker runs one trial at a time and receives it as JSON-compatible data.

    The answers arrive through `Workers`.
    """

    def __init__(self) -> None:
        self.trial: Trial | None = None
        self.ready = False  # True once the cell is loaded
        self.began = 0.0
        self.done = 0

    def give(self, trial: Trial) -> None:
        self.trial, self.began = trial, time.monotonic()
        self.send(asdict(trial))

    @abstractmethod
    def send(self, data: dict[str, Any]) -> None:
        """Send a trial to a worker of the pool. If the worker is dead, this call does not fail;
        `Workers.receive` reports the death later.
        """


W = TypeVar("W", bound=Worker)


class Workers(ABC, Generic[W]):
    """Interface for starting, polling and stopping the workers of a trial pool.

    Use an instance in a `with` block; all workers stop at the end of the block.

    Attributes:
        size: number of workers to run.
        help: hint for the user if no worker starts.
    """

    size: int
    help: str

    @abstractmethod
    def __enter__(self) -> Workers[W]: ...

    @abstractmethod
    def __exit__(self, *exc: object) -> None: ...

    @abstractmethod
    def start(self) -> W:
        """Start one more worker of the trial pool."""

    def endpoints(self) -> tuple[Endpoint, ...]:
        """Return the open sockets of a trial pool: the sockets of its workers and of the runtime that manages
        the workers, for example Ray.
        """
        return ()

    @abstractmethod
    def receive(self, seconds: float) -> Iterator[tuple[W, list[Answer] | None]]:
        """Yield each worker of the trial pool that has answered, together with its answers. For a dead
        worker, yield None instead of answers.

        Waits up to `seconds` for the first answer.
        """

    @abstractmethod
    def end(self, worker: W) -> str:
        """Stop a worker of the trial pool and return a text that says how it ended, e.g. "with status 7"."""


class Pool(Generic[W]):
    """Scheduler that runs trials on a pool of `workers`. Use it inside the `with` block of `workers`."""

    def __init__(self, spec: CampaignSpec, workers: Workers[W]):
        self.spec, self._workers = spec, workers
        self._all: list[W] = [workers.start() for _ in range(workers.size)]
        self._some_ready = time.monotonic()
        self.died = 0  # workers in a row that died while starting

    def _replace(self, worker: W) -> str:
        self._all.remove(worker)
        how = self._workers.end(worker)
        self._all.append(self._workers.start())
        return how

    def _died_at_start(self, how: str) -> None:
        """Count a worker of the trial pool that died while it was starting.

        Raises:
            InputError: too many workers in a row died while starting.
        """
        self.died += 1
        if self.died >= TRIES * self._workers.size:
            raise InputError(f"workers end {how} as they start", hint=self._workers.help)

    def _look_for_ready_ones(self) -> None:
        """Check that at least one worker of the trial pool is ready.

        Raises:
            InputError: no worker has been ready for `PATIENCE` seconds.
        """
        if any(worker.ready for worker in self._all):
            self._some_ready = time.monotonic()
        elif time.monotonic() - self._some_ready > PATIENCE:
            raise InputError(f"no worker is ready after {PATIENCE:g} s", hint=self._workers.help)

    def run(self, trials: Iterator[Trial]) -> Iterator[dict[str, Any]]:
        """Run trials in the pool. Yield the result row of each trial exactly once, as soon as the trial
        finishes.

        Raises:
            InputError: no worker starts.
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
            for worker, answers in self._workers.receive(GLANCE):
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
                    if "cell" in row:  # the worker cannot load the cell
                        raise InputError(
                            f"a worker says: {row['cell']}", hint="was the cell changed just now?"
                        )
                    worker.trial = None
                    worker.done += 1
                    if worker.done >= LIVES:
                        self._replace(worker)
                    else:
                        give(worker)  # before yielding, to keep the worker busy meanwhile
                    yield row
            for worker in list(self._all):
                late = time.monotonic() - worker.began
                if worker.trial is not None and late > self.spec.trial_seconds:
                    trial = worker.trial
                    self._replace(worker)
                    yield failed(trial, "TRIAL_TIMED_OUT", f"not over after {self.spec.trial_seconds:g} s")


class ProcessWorker(Worker):
    """Local process as a worker of the trial pool. The pool and the process exchange JSON lines through the
    standard input and output of the process.
    """

    def __init__(self, spec: CampaignSpec):
        super().__init__()
        with unsignaled():
            self.process = subprocess.Popen(
                # -P: do not import modules from the current folder
                [sys.executable, "-P", "-m", "armcell.campaigns.worker"],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, env={**os.environ, **ONE_THREAD},
            )  # fmt: skip
        self.rest = b""
        self.send(spec.as_dict())

    @property
    def output(self) -> int:
        assert self.process.stdout is not None
        return self.process.stdout.fileno()

    def send(self, data: dict[str, Any]) -> None:
        assert self.process.stdin is not None
        try:
            self.process.stdin.write(json.dumps(data).encode() + b"\n")
            self.process.stdin.flush()
        except BrokenPipeError:
            pass  # the process is dead; `answers` notices the end of its output

    def answers(self) -> list[Answer] | None:
        """Return the answers that a local process of the trial pool has sent since the last call, or None if
        the process is dead.
        """
        data = os.read(self.output, 1 << 16)
        if not data:
            return None
        *lines, self.rest = (self.rest + data).split(b"\n")
        return [json.loads(line) for line in lines]

    def end(self) -> int:
        self.process.kill()
        status = self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            try:
                if pipe is not None:
                    pipe.close()
            except BrokenPipeError:
                pass
        return status


class Processes(Workers[ProcessWorker]):
    """The `count` local processes that run a campaign's trials as the workers of a trial pool.

    This class starts, polls and stops the processes.
    """

    def __init__(self, spec: CampaignSpec, count: int):
        self.spec, self.size = spec, count
        self.help = (
            f"see what they say above; does `armcell check {spec.cell}` pass, is there memory for {count} of "
            "them (--workers 1)?"
        )
        self._selector = selectors.DefaultSelector()
        self._running: list[ProcessWorker] = []

    def __enter__(self) -> Processes:
        return self

    def __exit__(self, *exc: object) -> None:
        for worker in list(self._running):
            self.end(worker)
        self._selector.close()

    def start(self) -> ProcessWorker:
        worker = ProcessWorker(self.spec)
        self._running.append(worker)
        self._selector.register(worker.output, selectors.EVENT_READ, worker)
        return worker

    def receive(self, seconds: float) -> Iterator[tuple[ProcessWorker, list[Answer] | None]]:
        for key, _ in self._selector.select(timeout=seconds):
            worker: ProcessWorker = key.data
            if worker in self._running:  # skip a worker that `Pool` has replaced
                yield worker, worker.answers()

    def end(self, worker: ProcessWorker) -> str:
        self._selector.unregister(worker.output)
        self._running.remove(worker)
        return f"with status {worker.end()}"


def cores() -> int:
    """Return the number of processor cores that a trial pool can use for its worker processes."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
