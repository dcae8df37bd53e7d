"""Common parts of the planning benchmarks: planning, timing, result rows and table.

Times are CPU time of one thread. A problem whose start or goal is in contact (exact checker) has no solution:
its row has the contacts (`touching`) and no times, and is counted separately.
"""

from __future__ import annotations

import gzip
import json
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from rich.progress import track
from rich.table import Table

from armcell.cli.console import console, errors, write_json

if TYPE_CHECKING:
    from armcell.collision.kernel.checker import KernelChecker
    from armcell.planning.planners import NativeResult
    from armcell.scene import PlanningScene

Array = NDArray[np.float64]
Row = dict[str, Any]
Plan = Callable[["KernelChecker", Array, Array, Array, Array, float], "NativeResult"]

ROUNDS = 5  # attempts to plan a path that can be proven, as in the pipeline
TIMING_LIMITS = (2.0, 5.0)  # [rad/s], [rad/s^2] for every joint: the problems have no limits
MAX_LINES = 20  # printed lines of unsolved problems


@dataclass(frozen=True, eq=False)
class PlanTask:
    """Task of a planning benchmark: a start (dof,) and goals (g, dof) for the named joints in a scene."""

    family: str
    index: int
    scene: PlanningScene
    joint_names: tuple[str, ...]
    start: Array
    goals: Array
    lower: Array  # (dof,) sampling bounds
    upper: Array
    arms: tuple[str, ...] = ()  # groups that must keep a distance from each other
    apart: float = 0.0  # [m] that distance, if the start and goals allow it


def run(
    tasks: Iterable[PlanTask], total: int, planner_id: str, repeat: int, seconds: float
) -> Iterator[tuple[Row, Array | None]]:
    """Run the tasks of a planning benchmark. For each task, yield the result row and the waypoints of the
    fastest run.

    Each task is planned up to `repeat` times.

    Args:
        total: number of tasks, for the progress bar.
        seconds: time limit of one run [s].
    """
    from armcell.collision.kernel.checker import KernelChecker
    from armcell.planning import achievable_arm_clearance, warm_up

    plan = planner(planner_id)
    warm_up()
    hidden = not errors.is_terminal
    for task in track(tasks, "planning", total, console=errors, disable=hidden, transient=True):
        checker = KernelChecker(task.scene, task.joint_names)
        if words := endpoint_collisions(checker, task.start, task.goals):
            yield {**_row(task), "touching": words}, None
            continue
        goals, best = task.goals, None
        arm_clearance = achievable_arm_clearance(
            task.scene, task.arms, checker, task.start, tuple(goals), task.apart
        )
        if arm_clearance is not None:
            checker, goals = arm_clearance.apply_to(checker), np.vstack(arm_clearance.goals)
        for _ in range(repeat):
            answer = plan(checker, task.start, goals, task.lower, task.upper, seconds)
            if best is None or _total(answer) < _total(best):
                best = answer
            if answer.waypoints is None:
                break
        assert best is not None
        yield _row(task, best), best.waypoints


def endpoint_collisions(checker: KernelChecker, start: Array, goals: Array) -> str:
    """Describe the collisions that make a planning benchmark's task unsolvable: at the start, or at a goal if
    no goal is collision-free. The text is empty if the task has no such collisions.
    """

    def contacts(q: Array) -> str:
        if checker.exact.is_free(q):
            return ""
        return "; ".join(c.describe() for c in checker.exact.contacts(q, padded=False)[:3])

    if words := contacts(start):
        return f"start: {words}"
    found = [contacts(goal) for goal in goals]
    return f"goal: {found[0]}" if all(found) else ""


def planner(planner_id: str) -> Plan:
    """Return the function that plans for a planning benchmark, given `native` or an id PIPELINE/PLANNER.

    Pipelines other than `native` run without the proof of their raw path.

    Raises:
        UnknownNameError: the pipeline or planner does not exist.
    """
    from armcell.planning import find_planner, pipelines

    pipeline_id, _, name = planner_id.rpartition("/")
    if not pipeline_id and name in pipelines:
        pipeline_id, name = name, ""
    function = find_planner(pipeline_id, name)
    if function is find_planner("native", "RRTConnect"):
        return _native()
    return _of_pipeline(function)


def _native() -> Plan:
    from armcell.planning.planners import NativePlanner

    kept: list[NativePlanner] = []

    def plan(checker, start, goals, lower, upper, seconds):
        if not kept or len(kept[0].slack) != len(checker.joint_names):  # another robot
            kept[:] = [NativePlanner(checker)]
        kept[0].checker = checker
        stop = np.zeros(1, np.int64)
        timer = threading.Timer(seconds, stop.__setitem__, (0, 1))
        timer.start()
        try:
            return kept[0].plan(start, goals, lower, upper, stop=stop)
        finally:
            timer.cancel()

    return plan


def _of_pipeline(function) -> Plan:
    from armcell.planning import Problem
    from armcell.planning.planners import NativeResult, simplify

    def plan(checker, start, goals, lower, upper, seconds):
        deadline = time.monotonic() + seconds
        spent = np.zeros(3)  # times [s]: planning, shortening, proving
        for round_ in range(ROUNDS):
            problem = Problem(checker, start, tuple(goals), lower, upper, round_, deadline)
            times = [time.thread_time()]
            answer = function(problem)
            times.append(time.thread_time())
            raw = waypoints = answer.waypoints
            if raw is None:
                spent[0] += times[1] - times[0]
                break
            if not answer.simplified:
                waypoints = simplify(problem, raw)
            times.append(time.thread_time())
            proven = waypoints is not None and checker.certify(waypoints, evidence=False).free
            times.append(time.thread_time())
            spent += np.diff(times)
            if not proven:
                continue
            plan_s, simplify_s, certify_s = spent.tolist()
            return NativeResult(waypoints, raw, plan_s, simplify_s, certify_s)
        plan_s, simplify_s, certify_s = spent.tolist()
        return NativeResult(None, None, plan_s, simplify_s, certify_s)

    return plan


def _total(answer: NativeResult) -> float:
    return answer.plan_s + answer.simplify_s + answer.certify_s


def _row(task: PlanTask, answer: NativeResult | None = None) -> Row:
    row: Row = {
        "family": task.family,
        "index": task.index,
        "solved": False,
        **dict.fromkeys(
            ("plan_us", "simplify_us", "certify_us", "timing_us", "length_raw", "length"),
        ),
    }
    if answer is None:
        return row
    row["plan_us"] = answer.plan_s * 1e6
    row["simplify_us"] = answer.simplify_s * 1e6
    row["certify_us"] = answer.certify_s * 1e6
    if answer.waypoints is not None:
        row["solved"] = True
        row["timing_us"] = _timing_us(answer.waypoints, task.joint_names)
        row["length_raw"] = path_length(answer.raw)
        row["length"] = path_length(answer.waypoints)
    return row


def path_length(waypoints) -> float:
    """Return the joint-space length [rad] of a path in a planning benchmark,
    which is the sum of the lengths of its edges.
    """
    return float(np.linalg.norm(np.diff(waypoints, axis=0), axis=1).sum())


def _timing_us(waypoints: Array, names: tuple[str, ...]) -> float:
    from armcell.timing import BlendedPath, parameterize

    velocity, acceleration = (np.full(len(names), limit) for limit in TIMING_LIMITS)
    began = time.thread_time()
    parameterize(BlendedPath(waypoints, 0.05), names, velocity, acceleration)
    return (time.thread_time() - began) * 1e6


def report_results(
    found: Iterable[tuple[Row, Array | None]], json_file: Path | None, paths_file: Path | None = None
) -> int:
    """Print and write the rows of a planning benchmark.
    Return 0 if all solvable problems were solved, else 1.
    """
    rows: list[Row] = []
    paths: dict[str, dict[int, list]] = {}
    for row, waypoints in found:
        rows.append(row)
        if waypoints is not None:
            paths.setdefault(row["family"], {})[row["index"]] = waypoints.tolist()
    console.print(_table(rows))
    unsolved = [row for row in rows if not row["solved"]]
    for row in unsolved[:MAX_LINES]:
        words = row.get("touching") or "not solved"
        errors.print(f"{row['family']} {row['index']}: {words}", markup=False)
    if len(unsolved) > MAX_LINES:
        errors.print(f"and {len(unsolved) - MAX_LINES} more")
    if json_file is not None:
        write_json(json_file, rows)
    if paths_file is not None:
        with gzip.open(paths_file, "wt", encoding="utf-8") as out:
            json.dump(paths, out)
    return 0 if all(row["solved"] or "touching" in row for row in rows) else 1


def _table(rows: list[Row]) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    titles = ("family", "solved", "plan us", "p95", "+ simplify + prove us", "p95", "length", "raw")
    apart = any("touching" in row for row in rows)
    for title in (*titles, "start or goal touches") if apart else titles:
        table.add_column(title, justify="left" if title == "family" else "right")
    for family in [*dict.fromkeys(row["family"] for row in rows), "all"]:
        some = [r for r in rows if family in ("all", r["family"])]
        free = [r for r in some if "touching" not in r]
        good = [r for r in free if r["solved"]]
        cells = [""] * 6
        if good:
            plan = np.array([r["plan_us"] for r in good])
            total = plan + np.array([r["simplify_us"] + r["certify_us"] for r in good])
            cells = [f"{value:.0f}" for us in (plan, total) for value in np.percentile(us, (50, 95))]
            cells += [f"{np.mean([r[key] for r in good]):.2f}" for key in ("length", "length_raw")]
        if apart:
            cells.append(str(len(some) - len(free)))
        table.add_row(family, f"{len(good)}/{len(free)}", *cells)
    return table
