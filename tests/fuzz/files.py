"""Runs damaged inputs through the parsers, in a process of their own that may crash, hang or eat memory.

    python -m tests.fuzz --parsers                       10,000 inputs for each (make fuzz)
    python -m tests.fuzz --replay found/mesh-obj-1-17    one input again, with its traceback

An input depends on the seed, the parser and its number alone, so that a run can begin anywhere.
"""

from __future__ import annotations

import contextlib
import json
import os
import resource
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

INPUT_SECONDS = 2.0  # [s] of CPU time for one input
STUCK = 30.0  # [s] of wall time without a word from the process: it is stuck in compiled code
MEMORY = 2 << 30  # [bytes] that an input may take beside what the process has
SEEDS_WHOLE = 0.02  # share of inputs that are valid ones
FOUND = Path("fuzz-found")
ROOT = Path(__file__).parents[2]
PATHS: tuple[Path, ...] = (ROOT / "src", ROOT)  # of the process


class TooSlow(BaseException):
    """An input took its time; not an Exception, so that no parser takes it for its own."""


@dataclass
class Found:
    """One fault."""

    target: str
    number: int
    words: str
    file: Path


@dataclass
class Report:
    inputs: int = 0
    seconds: float = 0.0
    cpu: float = 0.0  # [s]
    accepted: dict[str, int] = field(default_factory=dict)  # inputs that were taken, by target
    faults: list[Found] = field(default_factory=list)


# --- in the process ---
def made(target, seed: int, number: int) -> bytes:
    """An input."""
    from tests.fuzz.corpus import Corpus

    corpus = Corpus(f"{seed}/{target.name}/{number}")
    data = corpus.pick(target.seeds)
    if corpus.chance(SEEDS_WHOLE):
        return data
    is_text = all(byte >= 9 for byte in data)
    for _ in range(corpus.pick((1, 1, 1, 1, 2))):
        text = corpus.chance(0.85 if is_text else 0.1)
        data = corpus.damage_text(data, target.seeds) if text else corpus.damage(data)
    return data


def take(target, file: Path, data: bytes) -> str:
    """Give an input to its parser; what is wrong, in words."""
    from tests.fuzz import parsers

    from armcell.core import ArmcellError

    file.write_bytes(data)
    parsers.forget()
    signal.setitimer(signal.ITIMER_PROF, INPUT_SECONDS)
    try:
        target.take(file)
        return "taken"
    except ArmcellError as error:
        str(error)
        return ""
    except TooSlow:
        return f"takes more than {INPUT_SECONDS:g} s"
    except MemoryError:
        return f"needs more than {MEMORY >> 20} MiB"
    except (Exception, SystemExit, KeyboardInterrupt) as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        return f"{type(error).__name__}: {error} ({Path(place.filename).name}:{place.lineno})"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)


def work(names: Sequence[str], seed: int, first: int, count: int) -> None:
    """The process's part: inputs from `first` on of the first target, all of the others. Tells by JSON lines.

    Before an input is taken it is in a file, for the case that nothing is told any more.
    """
    from tests.fuzz import parsers

    def too_slow(*_: object) -> None:
        raise TooSlow

    signal.signal(signal.SIGPROF, too_slow)
    tell = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what libraries print is nobody's answer
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    targets = parsers.targets()
    folder, unlimited = Path.cwd(), resource.getrlimit(resource.RLIMIT_AS)[1]
    for name in names:
        target = targets[name]
        file = target.folder(folder) / target.file
        for data in target.seeds:  # what is imported and compiled at first counts for no input
            with contextlib.suppress(BaseException):
                target.take(_written(file, data))
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + MEMORY, unlimited))
        taken, told = 0, time.monotonic()
        for number in range(first, count):
            (folder / "now").write_text(f"{name} {number}")
            words = take(target, file, made(target, seed, number))
            taken += words == "taken"
            if words not in ("", "taken"):
                tell.write(json.dumps({"target": name, "number": number, "fault": words}) + "\n")
                tell.flush()
            elif time.monotonic() > told + 1.0:
                tell.write("{}\n")
                tell.flush()
                told = time.monotonic()
        resource.setrlimit(resource.RLIMIT_AS, (unlimited, unlimited))
        tell.write(json.dumps({"done": name, "taken": taken, "count": count - first}) + "\n")
        tell.flush()
        first = 0
    usage = resource.getrusage(resource.RUSAGE_SELF)
    tell.write(json.dumps({"cpu": usage.ru_utime + usage.ru_stime}) + "\n")
    tell.flush()
    os._exit(0)


def _written(file: Path, data: bytes) -> Path:
    file.write_bytes(data)
    return file


# --- outside ---
def fuzz_parsers(
    names: Sequence[str], inputs: int, seed: int, found: Path = FOUND, most: int = 5,
    say: Callable[[str], None] = lambda text: None,
) -> Report:  # fmt: skip
    """Send `inputs` damaged inputs through each parser; a target is left alone after `most` faults."""
    report, began = Report(), time.monotonic()
    names, first = list(names), 0
    while names:
        at = _one_process(names, seed, first, inputs, found, most, report, say)
        if at is None:
            break
        name, first = at
        names = names[names.index(name) :]
        if first >= inputs:
            names, first = names[1:], 0
    report.seconds = time.monotonic() - began
    return report


def _one_process(names, seed, first, inputs, found, most, report, say) -> tuple[str, int] | None:
    """Run until all is done (None), or until a target and number from which another process goes on."""
    with tempfile.TemporaryDirectory(prefix="armcell-fuzz-") as folder:
        command = [sys.executable, "-m", "tests.fuzz", "--work", ",".join(names)]
        command += ["--seed", str(seed), "--first", str(first), "--inputs", str(inputs)]
        paths = os.pathsep.join(map(str, PATHS))
        environment = {
            **os.environ, "PYTHONPATH": paths, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1",
            "ARMCELL_GATE_KEY": str(Path(folder) / "key"),
        }  # fmt: skip
        process = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, env=environment)
        assert process.stdout is not None
        try:
            counts: dict[str, int] = {}
            rest = b""
            silent = time.monotonic()
            while True:
                if select.select([process.stdout], [], [], 1.0)[0]:
                    data = os.read(process.stdout.fileno(), 1 << 16)
                    if not data:
                        break
                    silent = time.monotonic()
                    *lines, rest = (rest + data).split(b"\n")
                    for told in map(json.loads, lines):
                        if "fault" in told:
                            name, number = told["target"], told["number"]
                            _keep(report, found, name, seed, number, told["fault"], say)
                            counts[name] = sum(f.target == name for f in report.faults)
                            if counts[name] >= most:
                                return name, inputs
                        elif "done" in told:
                            report.inputs += told["count"]
                            report.accepted[told["done"]] = told["taken"]
                            say(f"{told['done']}: {told['count']} inputs, {told['taken']} taken")
                        elif "cpu" in told:
                            report.cpu += told["cpu"]
                elif time.monotonic() > silent + STUCK:
                    process.kill()
                    return _broke(report, found, seed, folder, f"is stuck for {STUCK:g} s", say)
            status = process.wait()
            if status != 0:
                return _broke(report, found, seed, folder, f"ends the process with status {status}", say)
            return None
        finally:
            process.kill()
            process.wait()


def _broke(report, found, seed, folder, words, say) -> tuple[str, int]:
    now = Path(folder) / "now"
    assert now.exists(), f"the fuzzer's own process failed: {words}"
    name, number = now.read_text().split()
    _keep(report, found, name, seed, int(number), words, say)
    return name, int(number) + 1


def _keep(report, found, name, seed, number, words, say) -> None:
    from tests.fuzz import parsers

    target = parsers.targets()[name]
    found.mkdir(parents=True, exist_ok=True)
    file = found / f"{name}-{seed}-{number}"
    file.write_bytes(made(target, seed, number))
    report.faults.append(Found(name, number, words, file))
    say(f"{name}: input {number} {words}\n    again: python -m tests.fuzz --replay {file}")


def replay(file: Path) -> int:
    """Give a kept input to its parser again, here; its traceback, and whether there is a fault."""
    from tests.fuzz import parsers

    from armcell.core import ArmcellError

    names = sorted(parsers.targets(), key=len, reverse=True)
    name = next(n for n in names if file.name.startswith(n))
    target = parsers.targets()[name]
    with tempfile.TemporaryDirectory(prefix="armcell-fuzz-") as folder:
        where = target.folder(Path(folder)) / target.file
        shutil.copy(file, where)
        try:
            target.take(where)
        except ArmcellError as error:
            print(f"{name} refuses it: {error}")
        except BaseException:
            traceback.print_exc()
            return 1
        else:
            print(f"{name} takes it")
    return 0
