"""The bars planning is held to, and how far this run is from each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.planning.peers import KERNEL_OMPL, NATIVE, VAMP

Results = dict[str, Any]
Row = dict[str, Any]
Judge = Callable[[Results], tuple[str, bool]]
ROBOPLAN = "roboplan"
TOTAL_OF_VAMPS = "plan + simplify + certify as a multiple of VAMP's plan + simplify, median / p95"


@dataclass(frozen=True)
class Line:
    """One bar: what, how high, what was measured, and hit, missed or why it was skipped."""

    what: str
    bar: str
    measured: str
    verdict: str


class Skipped(Exception):
    """A line that this run has no data for; the text says why."""


def lines(results: Results) -> list[Line]:
    """Every bar, judged on a run's results; a line without data says why."""
    judged = []
    for what, bar, judge in BARS:
        try:
            measured, good = judge(results)
            judged.append(Line(what, bar, measured, "hit" if good else "MISSED"))
        except Skipped as reason:
            judged.append(Line(what, bar, "", f"skipped: {reason}"))
    return judged


def rows_of(results: Results, robot: str, planner: str = NATIVE) -> list[Row]:
    """Rows of a planner on a robot's problems with a free start and goal.

    Raises:
        Skipped: there are none.
    """
    found = [
        r for r in results.get("rows", [])
        if r["robot"] == robot and r["planner"] == planner and "touching" not in r
    ]  # fmt: skip
    if not found:
        raise Skipped(results.get("missing", {}).get("mbm", f"no {robot} problems in this run"))
    return found


def solved(rows: list[Row]) -> list[Row]:
    return [r for r in rows if r["solved"]]


def total_us(row: Row) -> float:
    return row["plan_us"] + row["simplify_us"] + row["certify_us"]


def middle(values: list[float]) -> tuple[float, float]:
    """Median and 95th percentile; infinite where there are no values, which misses every bar."""
    if not values:
        return np.inf, np.inf
    p50, p95 = np.percentile(values, (50, 95))
    return float(p50), float(p95)


def us(value: float) -> str:
    """A time in the unit that suits it."""
    if not np.isfinite(value):
        return "none"
    if value < 1000:
        return f"{value:.0f} us"
    return f"{value / 1000:.3g} ms" if value < 1e6 else f"{value / 1e6:.3g} s"


def _section(results: Results, name: str) -> Any:
    if name not in results:
        raise Skipped(results.get("missing", {}).get(name, "not part of this run"))
    return results[name]


def _all_solved(results: Results) -> tuple[str, bool]:
    words, good = [], True
    for robot in ("panda", "ur5"):
        rows = rows_of(results, robot)
        bad = [r for r in rows if r.get("contact")]
        words.append(f"{robot} {len(solved(rows))}/{len(rows)}{_left(results, robot)}, {len(bad)} touching")
        good &= len(solved(rows)) == len(rows) and not bad and not _left(results, robot)
    return "; ".join(words), good


def _left(results: Results, robot: str) -> str:
    """How many problems the run's time did not suffice for; empty if none."""
    count = results["problems"][robot]
    left = count["all"] - count["begun"]
    return f" (no time for {left})" if left else ""


def _plan(results: Results) -> tuple[str, bool]:
    p50, p95 = middle([r["plan_us"] for r in solved(rows_of(results, "panda"))])
    return f"{us(p50)} / {us(p95)}", p50 <= 60 and p95 <= 700


def _total(results: Results) -> tuple[str, bool]:
    p50, p95 = middle([total_us(r) for r in solved(rows_of(results, "panda"))])
    return f"{us(p50)} / {us(p95)}", p50 <= 250 and p95 <= 1500


def _beside(results: Results, robot: str, planner: str) -> tuple[list[float], list[float]]:
    """Total times [us] of armcell and of another planner, on the problems that both solved.

    Raises:
        Skipped: there are none.
    """
    ours = {(r["family"], r["index"]): total_us(r) for r in solved(rows_of(results, robot))}
    if not any(r["planner"] == planner for r in results["rows"]):
        raise Skipped(f"{planner} is not installed")
    theirs = {(r["family"], r["index"]): total_us(r) for r in solved(rows_of(results, robot, planner))}
    both = sorted(ours.keys() & theirs.keys())
    if not both:
        raise Skipped("no problem was solved by both")
    return [ours[k] for k in both], [theirs[k] for k in both]


def _against_roboplan(results: Results) -> tuple[str, bool]:
    ours, theirs = _beside(results, "panda", ROBOPLAN)
    mine, other = middle(ours)[0], middle(theirs)[0]
    return f"{other / mine:.1f} x (roboplan {us(other)}, {len(ours)} problems)", other / mine >= 50


def _against_vamp(robot: str, bar: float, bar_p95: float) -> Judge:
    def judge(results: Results) -> tuple[str, bool]:
        ours, theirs = _beside(results, robot, VAMP)
        (p50, p95), (other, other_p95) = middle(ours), middle(theirs)
        ratio, ratio_p95 = p50 / other, p95 / other_p95
        times = f"{us(p50)} / {us(p95)}; VAMP {us(other)} / {us(other_p95)}; {len(ours)} problems"
        return f"{ratio:.2f} / {ratio_p95:.2f} ({times})", ratio <= bar and ratio_p95 <= bar_p95

    return judge


def _length(robot: str, bar: float) -> Judge:
    def judge(results: Results) -> tuple[str, bool]:
        good = solved(rows_of(results, robot))
        length = float(np.mean([r["length"] for r in good])) if good else np.inf
        return f"{length:.2f} rad", length <= bar

    return judge


def _baxter(results: Results) -> tuple[str, bool]:
    rows = rows_of(results, "baxter")
    good = solved(rows)
    p50, _ = middle([r["plan_us"] for r in good])
    whole, _ = middle([total_us(r) for r in good])
    share = len(good) / len(rows)
    left = _left(results, "baxter")
    text = f"{len(good)}/{len(rows)} ({share:.1%}){left}, plan {us(p50)}, with proof {us(whole)}"
    return text, share >= 0.99 and p50 <= 8000


def _dual(results: Results) -> tuple[str, bool]:
    rows = _section(results, "dual")
    good = solved(rows)
    p50, p95 = middle([total_us(r) for r in good])
    text = f"{us(p50)} (p95 {us(p95)}), {len(good)}/{len(rows)} solved"
    return text, p50 <= 1000 and len(good) == len(rows)


def _kernel_ompl(results: Results) -> tuple[str, bool]:
    rows = rows_of(results, "panda", KERNEL_OMPL)
    p50, _ = middle([r["plan_us"] for r in solved(rows)])
    return f"{us(p50)}, {len(solved(rows))}/{len(rows)} solved", p50 <= 1000


def _ik(robot: str, bar: float, bar_p95: float) -> Judge:
    def judge(results: Results) -> tuple[str, bool]:
        s = _section(results, f"ik_{robot}")["summary"]
        p50, p95, share = s["compiled_us_median"], s["compiled_us_p95"], s["solved_percent"]
        text = f"{share:.1f} %, {p50:.1f} us (p95 {p95:.1f}); Python call {s['call_us_median']:.1f} us"
        return text, share == 100 and p50 <= bar and p95 <= bar_p95

    return judge


def _timing(results: Results) -> tuple[str, bool]:
    rows = _section(results, "timing")
    p50, _ = middle([r["timing_us"] for r in rows])
    peer, _ = middle([r["peer_us"] for r in rows])
    ratio = float(np.median([r["of_peer"] for r in rows]))
    text = f"{us(p50)} (toppra {us(peer)}), duration {ratio:.4f} of toppra's"
    return text, p50 <= 300 and ratio <= 1.01


def _pose_goal(results: Results) -> tuple[str, bool]:
    rows = _section(results, "pose_goals")
    p50, p95 = middle([r["us"] for r in solved(rows)])
    return f"{us(p50)} (p95 {us(p95)}), {len(solved(rows))}/{len(rows)} solved", p50 <= 1500


def _compile(results: Results) -> tuple[str, bool]:
    t = _section(results, "compile")
    first, later = t["first_cpu_s"], t["later_cpu_s"]
    return f"{first:.1f} CPU-s; later {later:.2f} s", first <= 30 and later <= 1


def _memory(results: Results) -> tuple[str, bool]:
    m = _section(results, "memory")
    times = f"plan {m['plan_ms_median']:.2f} ms, with solids instead {m['solids_plan_ms_median']:.2f} ms"
    text = f"{m['mb']:.0f} MB (whole process {m['process_mb']:.0f} MB), tree {m['build_ms']:.0f} ms, {times}"
    return f"{text}, {m['solved']}/{m['tasks']} solved", m["mb"] <= 300 and m["solved"] == m["tasks"]


BARS: list[tuple[str, str, Judge]] = [
    ("MBM panda and ur5: all solved; exact re-check at 0.002 rad", "all; 0 touching", _all_solved),
    ("panda: plan, median / p95", "60 us / 700 us", _plan),
    ("panda: plan + simplify + certify, median / p95", "250 us / 1.5 ms", _total),
    ("panda: the same beside roboplan's plan + shortcut, medians", "50 x faster", _against_roboplan),
    (f"panda: {TOTAL_OF_VAMPS}", "1.0 / 1.5", _against_vamp("panda", 1.0, 1.5)),
    (f"ur5: {TOTAL_OF_VAMPS}", "2.0 / 3.0", _against_vamp("ur5", 2.0, 3.0)),
    (f"Baxter: {TOTAL_OF_VAMPS}", "1.2 / none", _against_vamp("baxter", 1.2, np.inf)),
    (f"Fetch: {TOTAL_OF_VAMPS}", "2.5 / none", _against_vamp("fetch", 2.5, np.inf)),
    ("panda: mean length", "5.2 rad", _length("panda", 5.2)),
    ("ur5: mean length", "6.7 rad", _length("ur5", 6.7)),
    ("Baxter, both arms, 14 joints: solved, plan median", "99 %; 8 ms", _baxter),
    ("dual UR10 holding objects, 12 joints: plan + simplify + certify, median", "1 ms", _dual),
    ("panda: OMPL RRTConnect through the kernel, plan median", "1 ms", _kernel_ompl),
    ("UR10 IK, all branches, compiled", "100 %; 15 us", _ik("ur10", 15, np.inf)),
    ("Panda IK, compiled, median / p95", "100 %; 60 us / 300 us", _ik("panda", 60, 300)),
    ("time parameterisation, 20 waypoints", "300 us; within 1 % of toppra", _timing),
    ("pose goal to certified, timed trajectory, Python API, median", "1.5 ms", _pose_goal),
    ("first compile; later start", "30 CPU-s; 1 s", _compile),
    ("memory of a planner for two UR10 with a cloud of 200,000 points", "300 MB", _memory),
]
