"""Worker processes on this machine, for running a campaign's trials."""

from __future__ import annotations

import json
import os
import selectors
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

from armcell._interrupts import unsignaled
from armcell.campaigns.pool import Answer, Worker, Workers
from armcell.campaigns.spec import CampaignSpec

ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)


class ProcessWorker(Worker):
    """Worker process of a campaign on this machine.
    It runs `worker.py` and exchanges JSON lines through standard input and output.
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
        """Return the answers that a local worker process has sent since the last call, or None if the process
        is dead.
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
    """Interface to the `count` worker processes that run a campaign's trials on this machine.

    It starts, polls and stops the processes.
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
    """Return the number of processor cores that are available for a campaign's worker processes."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
