"""Worker processes on this machine. One that dies or hangs is replaced, and its trial given to another."""

from __future__ import annotations

import json
import os
import selectors
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

from armcell.campaigns.spec import CampaignSpec
from armcell.campaigns.trial import Trial, failed
from armcell.core import InputError

TRIES = 3  # of a trial whose worker dies
ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)
LIVES = 2000  # trials until a worker is replaced by a fresh one: whatever a library leaks ends with it


class _Worker:
    def __init__(self, spec: CampaignSpec):
        self.process = subprocess.Popen(
            [sys.executable, "-m", "armcell.campaigns.worker"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, env={**os.environ, **ONE_THREAD},
        )  # fmt: skip
        self.trial: Trial | None = None
        self.ready = False  # it has loaded the cell
        self.began = 0.0
        self.done = 0
        self.rest = b""
        self._send(spec.as_dict())

    @property
    def output(self) -> int:
        assert self.process.stdout is not None
        return self.process.stdout.fileno()

    def give(self, trial: Trial) -> None:
        self.trial, self.began = trial, time.monotonic()
        self._send(asdict(trial))

    def _send(self, data: dict[str, Any]) -> None:
        assert self.process.stdin is not None
        try:
            self.process.stdin.write(json.dumps(data).encode() + b"\n")
            self.process.stdin.flush()
        except BrokenPipeError:
            pass  # it is dead: its output ends, which is noticed there

    def answers(self) -> list[dict[str, Any]] | None:
        """What it has said since; None if it is dead."""
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


class Pool:
    """`workers` processes; use in a `with` block, at the end of which none is left."""

    def __init__(self, spec: CampaignSpec, workers: int):
        self.spec = spec
        self._selector = selectors.DefaultSelector()
        self._workers: list[_Worker] = []
        self.size = workers
        self.died = 0

    def __enter__(self) -> Pool:
        for _ in range(self.size):
            self._start()
        return self

    def __exit__(self, *exc: object) -> None:
        for worker in self._workers:
            self._selector.unregister(worker.output)
            worker.end()
        self._workers.clear()
        self._selector.close()

    def _start(self) -> _Worker:
        worker = _Worker(self.spec)
        self._workers.append(worker)
        self._selector.register(worker.output, selectors.EVENT_READ, worker)
        return worker

    def _replace(self, worker: _Worker) -> int:
        self._selector.unregister(worker.output)
        self._workers.remove(worker)
        status = worker.end()
        self._start()
        return status

    def _died_at_start(self, status: int) -> None:
        """
        Raises:
            InputError: too many in a row.
        """
        self.died += 1
        if self.died >= TRIES * self.size:
            raise InputError(
                f"worker processes end with status {status} as they start",
                cure=f"see what they say above; does `armcell check {self.spec.cell}` pass, is there memory "
                f"for {self.size} of them (--workers 1)?",
            )

    def run(self, trials: Iterator[Trial]) -> Iterator[dict[str, Any]]:
        """The rows of trials as they finish, each trial's exactly once.

        Raises:
            InputError: no worker comes up.
        """
        again: list[Trial] = []
        tries: dict[int, int] = {}
        over = False
        while True:
            for worker in self._workers:
                if worker.trial is None and not over:
                    trial = again.pop() if again else next(trials, None)
                    if trial is None:
                        over = True
                    else:
                        worker.give(trial)
            if all(worker.trial is None for worker in self._workers):
                return
            for key, _ in self._selector.select(timeout=1.0):
                worker: _Worker = key.data
                answers = worker.answers()
                if answers is None:
                    trial, status = worker.trial, self._replace(worker)
                    if not worker.ready:
                        self._died_at_start(status)
                        if trial is not None:
                            again.append(trial)
                            over = False
                        continue
                    if trial is None:
                        continue
                    tries[trial.number] = tries.get(trial.number, 0) + 1
                    if tries[trial.number] < TRIES:
                        again.append(trial)
                        over = False
                    else:
                        text = f"its process ended {TRIES} times, at last with status {status}"
                        yield failed(trial, "CRASHED", text)
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
                    yield row
                if worker.done >= LIVES and worker.trial is None:
                    self._replace(worker)
            for worker in list(self._workers):
                late = time.monotonic() - worker.began
                if worker.trial is not None and late > self.spec.trial_seconds:
                    trial = worker.trial
                    self._replace(worker)
                    yield failed(trial, "TIMED_OUT", f"not over after {self.spec.trial_seconds:g} s")
