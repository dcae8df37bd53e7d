"""Fuzzing every parser, and what is open to a network.

    python -m tests.fuzz --seed 1                         both (make fuzz)
    python -m tests.fuzz --frames 0 --only mesh-obj cell  some parsers alone; see files.py
    python -m tests.fuzz --inputs 0 --frames 1000000      the wires alone

The wires' servers get damaged input that is guided by what it made the code do. Inputs are drawn from
grammars of valid ones and damaged; those that took a way through the code that none took before are kept
and damaged further. The run is cut into rounds, each with servers of its own.
"""

from __future__ import annotations

import argparse
import contextlib
import logging
import os
import resource
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from tests.fuzz import files
from tests.fuzz.decoders import Decoders
from tests.fuzz.edges import Edges
from tests.fuzz.ros1_ports import Tcpros, XmlRpc
from tests.fuzz.ros_tcp import RosTcp

TARGETS = (RosTcp, Decoders, Tcpros, XmlRpc)
ROUNDS = 10
CHECK = 20  # inputs between two looks at a bystander
SETTLE = 10.0  # [s] for threads and sockets of a round to be gone


@dataclass
class Round:
    """What one target did in one round."""

    target: str
    frames: int
    seconds: float
    cpu: float  # [s]
    edges: int  # of the whole run so far
    kept: int  # inputs of this target so far


@dataclass
class Report:
    """What a run has seen."""

    frames: int = 0
    seconds: float = 0.0
    rounds: list[Round] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)  # crashes, hangs and leaks
    resident: list[float] = field(default_factory=list)  # [MiB] after each round


class _Faults(logging.Handler):
    """An exception that our code logs is a crash somebody has to look at."""

    def __init__(self, faults: list[str]):
        super().__init__(logging.ERROR)
        self._faults = faults

    def emit(self, record):
        if record.exc_info:
            self._faults.append(self.format(record))


def fuzz(
    frames: int, seed: int, seconds: float = float("inf"), say: Callable[[str], None] = lambda text: None
) -> Report:
    """Send damaged input until about `frames` frames are handled or `seconds` [s] have passed."""
    report = Report()
    began = time.monotonic()
    with _watched(report.faults), Edges() as edges:
        targets = [make(seed + i, edges) for i, make in enumerate(TARGETS)]
        while report.frames < frames and time.monotonic() < began + seconds and not report.faults:
            for target in targets:
                _round(target, max(round(frames * target.share / ROUNDS), 1), edges, report, began + seconds)
            report.frames = sum(target.frames for target in targets)
            report.resident.append(_resident())
            report.seconds = time.monotonic() - began
            say(
                f"{report.seconds:5.0f} s: {report.frames} frames, {edges.count} edges, "
                f"{sum(len(t.corpus.kept) for t in targets)} inputs kept, {report.resident[-1]:.0f} MiB"
            )
    return report


def _round(target, frames: int, edges: Edges, report: Report, end: float) -> None:
    began, cpu, before = time.monotonic(), time.process_time(), target.frames
    threads, files = threading.active_count(), _open_files()
    try:
        with target.opened():
            count = 0
            while target.frames < before + frames and time.monotonic() < end and not report.faults:
                target.send()
                count += 1
                if count % CHECK == 0:
                    target.check()
            target.check()
    except Exception as error:  # whatever it is, it is what is looked for
        report.faults.append(f"{target.name}: {type(error).__name__}: {error}")
        return
    give_up = time.monotonic() + SETTLE
    while threading.active_count() > threads or _open_files() > files:
        if time.monotonic() > give_up:
            left = f"{threading.active_count() - threads} threads, {_open_files() - files} files"
            report.faults.append(f"{target.name}: left over: {left}")
            break
        time.sleep(0.01)
    report.rounds.append(
        Round(
            target.name, target.frames - before, time.monotonic() - began, time.process_time() - cpu,
            edges.count, len(target.corpus.kept),
        )
    )  # fmt: skip


@contextlib.contextmanager
def _watched(faults: list[str]) -> Iterator[None]:
    """Crashes are noted, and nothing is connected to but this run's own servers, whatever a damaged
    address says: other programs of this machine have nothing to do with it."""
    handler, log = _Faults(faults), logging.getLogger("armcell")
    old_hook, connect, opens = threading.excepthook, socket.create_connection, socket.socket.listen
    own: set[int] = set()

    def listen(sock, *args):
        opens(sock, *args)
        if sock.family == socket.AF_INET:
            own.add(sock.getsockname()[1])

    def create_connection(address, *args, **kwargs):
        if address[0] not in ("127.0.0.1", "localhost") or address[1] not in own:
            raise ConnectionRefusedError(f"{address}: not of this run")
        return connect(address, *args, **kwargs)

    log.addHandler(handler)
    threading.excepthook = lambda args: faults.append(f"{args.thread}: {args.exc_value!r}")
    socket.socket.listen, socket.create_connection = listen, create_connection  # type: ignore[method-assign]
    try:
        yield
    finally:
        socket.socket.listen, socket.create_connection = opens, connect  # type: ignore[method-assign]
        threading.excepthook = old_hook
        log.removeHandler(handler)


def _open_files() -> int:
    return len(os.listdir("/proc/self/fd"))


def _resident() -> float:
    """[MiB]"""
    pages = int(open("/proc/self/statm").read().split()[1])  # noqa: SIM115
    return pages * resource.getpagesize() / 2**20


def main() -> int:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--frames", type=int, default=1_000_000)
    arguments.add_argument("--seed", type=int, default=int(time.time()))
    arguments.add_argument("--seconds", type=float, default=1800.0)
    arguments.add_argument("--inputs", type=int, default=10_000, help="for each parser")
    arguments.add_argument("--only", nargs="*", help="parsers; all without")
    arguments.add_argument(
        "--found", type=Path, default=files.FOUND, help="where inputs with faults are kept"
    )
    arguments.add_argument("--replay", type=Path, help="a kept input")
    arguments.add_argument("--work", help=argparse.SUPPRESS)
    arguments.add_argument("--first", type=int, default=0, help=argparse.SUPPRESS)
    given = arguments.parse_args()
    if given.work:
        files.work(given.work.split(","), given.seed, given.first, given.inputs)
    if given.replay:
        return files.replay(given.replay)
    logging.getLogger("armcell").setLevel(logging.ERROR)
    print(f"seed {given.seed}, Python {sys.version.split()[0]}", flush=True)
    faults = 0
    if given.inputs:
        from tests.fuzz.parsers import targets

        read = files.fuzz_parsers(
            given.only or list(targets()), given.inputs, given.seed, given.found,
            say=lambda text: print(text, flush=True),
        )  # fmt: skip
        faults = len(read.faults)
        print(
            f"parsers: {read.inputs} inputs in {read.seconds:.0f} s ({read.cpu:.0f} s of CPU time), "
            f"{faults} faults",
            flush=True,
        )
    return max(_wires(given), min(faults, 1)) if given.frames else min(faults, 1)


def _wires(given: argparse.Namespace) -> int:
    report = fuzz(given.frames, given.seed, given.seconds, lambda text: print(text, flush=True))
    for name in (target.name for target in TARGETS):
        rounds = [r for r in report.rounds if r.target == name]
        total, took, cpu = (sum(getattr(r, part) for r in rounds) for part in ("frames", "seconds", "cpu"))
        kept = rounds[-1].kept if rounds else 0
        print(f"{name}: {total} frames in {took:.0f} s ({cpu:.0f} s of CPU time), {kept} inputs kept")
    for fault in report.faults[:5]:
        print(fault)
    print(f"{report.frames} frames, {len(report.faults)} crashes, hangs or leaks")
    return 1 if report.faults else 0


if __name__ == "__main__":
    sys.exit(main())
