"""Campaigns: how many trials an hour, what the engine and Ray cost, kills, memory, a run executed again.

    python -m benchmarks.campaign --trials 100 --kills 20

The same trials run in a bare loop (no engine, no store), in two such loops at once (what the machine gives
two processes that have nothing to do with each other), with one worker, with two, and on Ray, each in new
processes; in rounds, every other one backwards, as a machine's speed may change from minute to minute.

What the engine costs is processor time: of the worker and of the campaign's process, from the first row to
the last, against the loop's, and against that of the trials in it. Waiting for the processor, on a machine
that others use, is not in it. `hand-over` is what passes between two rows of one worker beyond the trial; it
and the speed-up are wall time. The ratio of two ways is the median of the rounds.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from statistics import median
from typing import Any

import armcell
from armcell.campaigns import CampaignSpec, Store, begin, resume, rows_of, run
from armcell.campaigns.campaign import trial
from armcell.campaigns.store import TRIALS
from armcell.campaigns.trial import run_trial
from armcell.planning import warm_up
from benchmarks.picture import dots

RATE = 15000  # trials an hour and core that are wanted
TICK = os.sysconf("SC_CLK_TCK")
MIB = 2**20
QUICK = """robot: panda
start: {arm: home}
objects:
  box: {box: [0.1, 0.1, 0.1], pose: [0.25, 0.3, 1.0]}
task: [{move: extended}]
"""  # for the kills: a trial takes a moment, and some fail
VARIED = {"objects.box.pose.y": [-0.4, 0.4], "objects.box.pose.z": [0.8, 1.1]}
TIMED = ("wall_s", "cpu_s", "planning_s")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--trials", type=int, default=100, help="of panda_pick, in each way of running them")
    parser.add_argument("--rounds", type=int, default=5, help="in which all ways take turns")
    parser.add_argument("--kills", type=int, default=20, help="random moments at which something is killed")
    parser.add_argument("--cell", default="panda_pick")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--picture", type=Path, help="where to draw what a trial costs in each way")
    given = parser.parse_args()
    if given.trials < 4 * given.rounds:
        parser.error(f"{given.rounds} rounds need at least {4 * given.rounds} trials")
    found: dict[str, Any] = {"cell": given.cell, "trials": given.trials, "load_before": os.getloadavg()[0]}
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        share = -(-given.trials // given.rounds)
        ways: dict[str, tuple[int, str | None]] = {"one worker": (1, None), "two workers": (2, None)}
        if importlib.util.find_spec("ray"):
            ways["Ray, one worker"] = (1, "auto")
        parts: dict[str, list[dict[str, Any]]] = {name: [] for name in ("loop", "two loops", *ways)}
        for first in range(0, given.trials, share):
            spec = CampaignSpec(given.cell, trials=min(share, given.trials - first), seed=first)
            backwards = len(parts["loop"]) % 2 == 1
            for name in reversed(parts) if backwards else parts:
                if name == "loop":
                    parts[name].append(in_new_processes(bare_loop, [spec])[0])
                elif name == "two loops":
                    parts[name].append(side_by_side(in_new_processes(bare_loop, halves(spec))))
                else:
                    kept = root / f"{name} {first}".replace(" ", "_")
                    parts[name].append(with_engine(spec, kept, *ways[name]))
            spent = ", ".join(f"{name} {rounds[-1]['cpu_s']:.3f}" for name, rounds in parts.items())
            print(f"trial {first} on, processor time of a trial [s]: {spent}", flush=True)
        found |= {name: together(rounds) for name, rounds in parts.items()}
        found["kills"] = kills(root, given.kills)
        print("kills", json.dumps(found["kills"]), flush=True)
        found["executed again"] = executed_again(given.cell, root / "runs")
        print("executed again", json.dumps(found["executed again"]), flush=True)
    found["load_after"] = os.getloadavg()[0]
    print_table(found)
    if given.picture:
        spent = {name: found[name]["rounds_cpu_s"] for name in parts}
        dots(given.picture, spent, "processor time of a trial, by round [s]", 3600 / RATE)
    if given.json:
        given.json.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")


# --- rates ---
def in_new_processes(call: Callable[[CampaignSpec], Any], specs: list[CampaignSpec]) -> list[Any]:
    """At once, each in its own."""
    with ProcessPoolExecutor(len(specs), get_context("spawn")) as processes:
        return list(processes.map(call, specs))


def halves(spec: CampaignSpec) -> list[CampaignSpec]:
    first = (spec.trials + 1) // 2
    return [replace(spec, trials=first), replace(spec, trials=spec.trials - first, seed=spec.seed + first)]


def side_by_side(loops: list[dict[str, Any]]) -> dict[str, Any]:
    """What loops that ran at once did together."""
    return {
        "cpu_s": sum(loop["cpu_s"] for loop in loops) / len(loops),
        "wall_s": 1 / sum(1 / loop["wall_s"] for loop in loops),
        "succeeded": sum(loop["succeeded"] for loop in loops),
    }


def bare_loop(spec: CampaignSpec) -> dict[str, Any]:
    """The campaign's trials one after the other in this process. The first loads things and is left out."""
    warm_up()
    cell, good = armcell.load(spec.cell), 0
    began = cpu = 0.0
    for number in range(spec.trials):
        if number == 1:
            began, cpu = time.monotonic(), time.process_time()
        good += run_trial(cell, trial(spec, {}, number))["success"]
    count = spec.trials - 1
    return {
        "cpu_s": (time.process_time() - cpu) / count, "wall_s": (time.monotonic() - began) / count,
        "succeeded": good,
    }  # fmt: skip


def together(rounds: list[dict[str, Any]]) -> dict[str, Any]:
    """Means over rounds; counts of all of them; the memory as it was where a worker had most."""
    first, found = rounds[0], {}
    for key, value in first.items():
        every = [one[key] for one in rounds]
        if key == "resident_mib":
            found[key] = max(every, key=max)
        elif isinstance(value, int):
            found[key] = sum(every)
        else:
            found[key] = None if value is None else sum(every) / len(every)
    return found | {f"rounds_{key}": [one[key] for one in rounds] for key in ("cpu_s", "wall_s")}


def ratio(a: dict[str, Any], b: dict[str, Any], what: str) -> float:
    """Of one way to another, the median of the rounds: each round's two ran soon after each other."""
    return median(x / y for x, y in zip(a[f"rounds_{what}"], b[f"rounds_{what}"], strict=True))


class Watch:
    """Looks at workers' processor time and memory after each row."""

    def __init__(self) -> None:
        self.walls: list[float] = []
        self.cpus: list[float] = []
        self.resident: list[float] = []

    def __call__(self, store: Store, count: int) -> None:
        workers = [pid for pid in below(os.getpid()) if _is_worker(pid)]
        self.walls.append(time.monotonic())
        self.cpus.append(time.process_time() + sum(cpu_of(pid) for pid in workers))
        self.resident.append(max((resident_of(pid) for pid in workers), default=0.0))


def with_engine(spec: CampaignSpec, root: Path, workers: int, ray: str | None) -> dict[str, Any]:
    """The same trials with the engine, from the first row to the last."""
    store, watch = begin(spec, root), Watch()
    run(store, workers, watch, ray)
    store.close()
    rows = list(store.rows.values())  # in the order they came
    count, wall = len(rows) - 1, watch.walls[-1] - watch.walls[0]
    tenth = max(count // 10, 1)
    return {
        "cpu_s": (watch.cpus[-1] - watch.cpus[0]) / count,
        "beside_trials": (watch.cpus[-1] - watch.cpus[0]) / sum(row["cpu_s"] for row in rows[1:]) - 1,
        "wall_s": wall / count,
        "hand_over_ms": 1e3 * (wall - sum(row["wall_s"] for row in rows[1:])) / count
        if workers == 1
        else None,
        "succeeded": sum(row["success"] for row in rows),
        "unwanted_contacts": sum(row["unwanted_contacts"] for row in rows),
        "resident_mib": [watch.resident[tenth], watch.resident[-1], max(watch.resident)],
    }


# --- kills ---
def kills(root: Path, count: int) -> dict[str, Any]:
    """Workers and the campaign's own process killed at random moments, with `--resume` after each."""
    cell = root / "quick.yaml"
    cell.write_text(QUICK)
    spec = CampaignSpec(str(cell), VARIED, trials=20 + 8 * count)
    store = begin(spec, root / "unbroken")
    run(store, 2)
    store.close()
    want = table(store.folder)
    rng = random.Random(8)
    broken = begin(spec, root / "broken")
    broken.close()
    killed = {"worker": 0, "head": 0}
    left = 0
    while sum(killed.values()) < count:
        head = subprocess.Popen(
            [sys.executable, "-m", "armcell", "campaign", "--resume", str(broken.folder), "--workers", "2"],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        before, deadline = len(rows_of(broken.folder / TRIALS)[0]), time.monotonic() + 120
        starting = rng.random() < 0.25  # else once it works
        while head.poll() is None and time.monotonic() < deadline:
            workers = [pid for pid in below(head.pid) if _is_worker(pid)]
            if workers and (starting or len(rows_of(broken.folder / TRIALS)[0]) > before):
                break
            time.sleep(0.02)
        for _ in range(rng.randint(0, 2)):
            time.sleep(rng.uniform(0.0, 0.5))
            workers = [pid for pid in below(head.pid) if _is_worker(pid)]
            if workers and head.poll() is None and sum(killed.values()) < count - 1:
                end(rng.choice(workers))
                killed["worker"] += 1
        time.sleep(rng.uniform(0.0, 0.5))
        family = list(below(head.pid))
        if head.poll() is None:
            end(head.pid)
            killed["head"] += 1
        head.wait()
        patience = time.monotonic() + 30  # one that still imports notices when it has done so
        while any(_is_worker(pid) for pid in family) and time.monotonic() < patience:
            time.sleep(0.1)
        left += sum(_is_worker(pid) for pid in family)
    kept = len(rows_of(broken.folder / TRIALS)[0])
    store = resume(broken.folder)
    run(store, 2)
    store.close()
    lines = [row["trial"] for row in rows_of(broken.folder / TRIALS)[0]]
    return {
        "killed": killed, "trials": spec.trials, "kept_before_the_last_resume": kept,
        "same_table": table(store.folder) == want, "counted_twice": len(lines) - len(set(lines)),
        "lost": spec.trials - len(set(lines)), "workers_left": left,
        "failures_in_it": sum(not row["success"] for row in want),
    }  # fmt: skip


def table(folder: Path) -> list[dict[str, Any]]:
    """A campaign's rows by trial, without what is measured by a clock."""
    rows = sorted(rows_of(folder / TRIALS)[0], key=lambda row: row["trial"])
    return [{k: v for k, v in row.items() if k not in TIMED} for row in rows]


# --- records ---
def executed_again(cell: str, root: Path) -> dict[str, Any]:
    """A recorded run, and the same executed again: `armcell replay --execute` compares bit for bit."""

    def quietly(*words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run([sys.executable, "-m", "armcell", *words], capture_output=True, text=True)

    quietly("run", cell, "--seed", "7", "--runs", str(root))
    first = next((file.parent for file in sorted(root.glob("*/run.mcap"))), None)
    if first is None:
        return {"same": False, "said": "no record"}
    again = quietly("replay", str(first), "--execute", "--runs", str(root))
    said = (again.stdout + again.stderr).strip().splitlines()
    return {"same": again.returncode == 0, "said": said[-1] if said else ""}


# --- processes ---
def below(pid: int) -> Iterator[int]:
    """All descendants of a process."""
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except OSError:
        return
    for child in map(int, children):
        yield child
        yield from below(child)


def _is_worker(pid: int) -> bool:
    try:
        words = Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return False
    return b"armcell.campaigns.worker" in words or b"ray::_Actor" in words


def cpu_of(pid: int) -> float:
    """[s] of a process that is not this one."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICK


def resident_of(pid: int) -> float:
    """[MiB]"""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / MIB


def end(pid: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)


# --- the table ---
def print_table(found: dict[str, Any]) -> None:
    loop, one, two = found["loop"], found["one worker"], found["two workers"]
    killed = found["kills"]
    rows: list[tuple[str, str, str, bool]] = []

    def row(what: str, value: float, bar: float, unit: str, at_least: bool = False) -> None:
        sign = ">=" if at_least else "<="
        met = value >= bar if at_least else value <= bar
        shown = f"{value:,.0f}" if value >= 1000 else f"{value:.4g}"
        rows.append((what, f"{shown} {unit}".strip(), f"{sign} {bar:,g} {unit}".strip(), met))

    row("trials per hour and core (processor time)", 3600 / one["cpu_s"], RATE, "", at_least=True)
    every = [3600 / spent for spent in one["rounds_cpu_s"]]
    rows.append(("the same in single rounds", f"{min(every):,.0f} to {max(every):,.0f}", "", True))
    row("engine against a bare loop (processor time)", 100 * (ratio(one, loop, "cpu_s") - 1), 5, "%")
    row("engine against the trials in it (processor time)", 100 * one["beside_trials"], 5, "%")
    row("two workers against one (wall time)", ratio(one, two, "wall_s"), 1.8, "", at_least=True)
    given = ratio(loop, found["two loops"], "wall_s")
    rows.append(("two bare loops at once against one (wall time)", f"{given:.4g}", "", True))
    row("hand-over of a trial, local", one["hand_over_ms"], 10, "ms")
    if "Ray, one worker" in found:
        row("hand-over of a trial, Ray", found["Ray, one worker"]["hand_over_ms"], 10, "ms")
    row("succeeded", 100 * one["succeeded"] / found["trials"], 99.9, "%", at_least=True)
    row("unwanted contacts", one["unwanted_contacts"], 0, "")
    row("memory of a worker, most", max(one["resident_mib"]), 1536, "MiB")
    row(
        "memory of a worker, last against a tenth", one["resident_mib"][1] - one["resident_mib"][0], 50, "MiB"
    )
    what = f"{killed['killed']['worker']} workers and {killed['killed']['head']} heads killed"
    bad = killed["lost"] + killed["counted_twice"] + killed["workers_left"]
    rows.append((what, "same table" if killed["same_table"] else "another table", "same table",
                 killed["same_table"] and not bad))  # fmt: skip
    same = found["executed again"]["same"]
    rows.append(("a run executed again", "identical" if same else "differs", "identical", same))
    print(f"\n{found['cell']}, {found['trials']} trials; load {found['load_before']:.1f} before")
    print("| what | measured | bar | |\n|---|---:|---:|---|")
    for what, value, bar, met in rows:
        print(f"| {what} | {value} | {bar} | {'met' if met else 'missed'} |")


if __name__ == "__main__":
    main()
