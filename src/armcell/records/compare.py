"""Comparison of two recorded runs: states bit by bit, events, plans, outcome and inputs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from armcell.core import Event, JointTrajectory
from armcell.records.mcap_writer import NANO
from armcell.records.reader import Array, Record, RecordedJoints, RecordedState

THRESHOLDS = (1e-9, 1e-6, 1e-4, 1e-2)
"""Deviations, [rad or m] for joints and [m] for objects, whose first occurrence is reported."""
TIMINGS = (
    "planning_time_s", "wall_time_s", "total_planning_time_s", "started_s",
    "seconds",  # duration of a search stage
    "plan_us", "simplify_us", "certify_us", "cost_over_time",  # planner timings
)  # fmt: skip
"""Wall-clock values in events and results, ignored because they differ between any two runs."""
AT_ONCE = NANO // 1000
"""Minimum tolerance [ns] within which two states count as simultaneous."""


@dataclass(frozen=True)
class FirstDivergence:
    """First difference that was found between two compared runs."""

    time: float  # [s]
    what: str  # "position of elbow_joint", "pose of cube", "time", "length"
    first: Any
    second: Any

    def __str__(self) -> str:
        def said(value: Any) -> str:
            return f"{value:.17g}" if isinstance(value, float) else str(value)

        return f"at {self.time:.3f} s: {self.what} is {said(self.first)} / {said(self.second)}"


@dataclass(frozen=True)
class Deviation:
    """Largest deviation of one joint or object between two compared runs."""

    what: str  # joint or object
    largest: float  # [rad or m]
    at: float  # [s] time of the largest deviation
    reached: tuple[tuple[float, float], ...]  # (threshold, first time [s] above it)


@dataclass(frozen=True)
class Comparison:
    """Comparison of two recorded runs with respect to their inputs, states, events, plans and outcomes."""

    input_differences: tuple[str, ...]  # cell, seed, versions, ...
    states: int  # number of compared states
    same_states: int  # number of bit-identical states from the start
    state: FirstDivergence | None
    distances: tuple[Deviation, ...]  # deviations, largest first
    event: FirstDivergence | None
    plan: FirstDivergence | None
    outcome: FirstDivergence | None
    cut: tuple[str, ...] = ()  # incomplete records and the causes

    @property
    def same_course(self) -> bool:
        """Return whether two compared runs have identical states, events and plans."""
        return self.state is None and self.event is None and self.plan is None

    @property
    def identical(self) -> bool:
        return self.same_course and self.outcome is None and not self.input_differences

    def words(self) -> list[str]:
        """Return the comparison of two runs as lines of text."""
        lines = [*self.cut, *(f"asked: {part}" for part in self.input_differences)]
        if self.state is None:
            lines.append(f"states: all {self.states} identical to the bit")
        else:
            lines.append(f"states: the first {self.same_states} of {self.states} identical to the bit")
            lines.append(f"states: first different {self.state}")
        for each in self.distances:
            above = ", ".join(f"{limit:g} at {at:.2f} s" for limit, at in each.reached)
            above = f"; above {above}" if above else ""
            lines.append(f"  {each.what}: at most {each.largest:.3g} apart, at {each.at:.2f} s{above}")
        for name, found in (("events", self.event), ("plans", self.plan), ("outcome", self.outcome)):
            lines.append(f"{name}: the same" if found is None else f"{name}: first different {found}")
        return lines


def compare(first: Record, second: Record) -> Comparison:
    """Compare two recorded runs. States are paired by the time of the cell's clock."""
    pairs = list(_pairs(first.states, second.states))
    state, same = None, 0
    for a, b in pairs:
        state = _state_divergence(a, b)
        if state is not None:
            break
        same += 1
    if state is None and len(first.states) != len(second.states) and not (first.cut or second.cut):
        ends = first.states[-1].time, second.states[-1].time
        state = FirstDivergence(min(ends), "the last state's time", *ends)
    return Comparison(
        tuple(_input_differences(first.metadata, second.metadata)),
        len(pairs),
        same,
        state,
        _distances(pairs) if state is not None else (),
        _event_divergence(first, second),
        _plan_divergence(first, second),
        _outcome_divergence(first.result, second.result),
        tuple(f"{r.file}: {r.cut}" for r in (first, second) if r.cut),
    )


# --- inputs ---
def _input_differences(a: Mapping[str, Any], b: Mapping[str, Any]) -> Iterator[str]:
    for key in ("cell", "mode", "seed"):
        if a.get(key) != b.get(key):
            yield f"{key} {a.get(key)} / {b.get(key)}"
    ours, theirs = a.get("hashes", {}), b.get("hashes", {})
    for part in sorted({*ours, *theirs}):
        if ours.get(part) != theirs.get(part):
            library = part.partition("versions.")[2]
            both = (m.get("versions", {}).get(library) for m in (a, b))
            yield f"{library} {' / '.join(map(str, both))}" if library else f"another {part}"


# --- states ---
def _pairs(
    a: tuple[RecordedState, ...], b: tuple[RecordedState, ...]
) -> Iterator[tuple[RecordedState, RecordedState]]:
    """Yield pairs of simultaneous states of two compared runs.

    Paced and real runs have irregular sampling times: each state is paired with the nearest state of the
    other run that is within half a sampling period.
    """
    times = np.array([s.nanoseconds for s in b])
    if len(times) == 0:
        return
    period = np.median(np.diff(times)) if len(times) > 1 else AT_ONCE
    for state in a:
        k = int(np.searchsorted(times, state.nanoseconds))
        near = min(
            (i for i in (k - 1, k) if 0 <= i < len(times)), key=lambda i: abs(times[i] - state.nanoseconds)
        )
        if abs(times[near] - state.nanoseconds) <= max(period / 2, AT_ONCE):
            yield state, b[near]


def _state_divergence(a: RecordedState, b: RecordedState) -> FirstDivergence | None:
    if a.nanoseconds != b.nanoseconds:
        return FirstDivergence(a.time, "the state's time", a.time, b.time)
    for label, one, two in (
        ("", a.joints, b.joints), ("target ", a.targets, b.targets), ("gripper ", a.grippers, b.grippers)
    ):  # fmt: skip
        if (found := _joints_divergence(a.time, label, one, two)) is not None:
            return found
    for name in {**a.poses, **b.poses}:
        one, two = a.poses.get(name), b.poses.get(name)
        if one is None or two is None or one.tobytes() != two.tobytes():
            return FirstDivergence(
                a.time, f"pose of {name}", *(None if p is None else p.tolist() for p in (one, two))
            )
    if a.contacts != b.contacts:
        here, there = (sorted({f"{x[0]}-{x[1]}" for x in c}) for c in (a.contacts, b.contacts))
        return FirstDivergence(a.time, "what touches (or how deep)", here, there)
    return None


def _joints_divergence(
    time: float, label: str, a: RecordedJoints | None, b: RecordedJoints | None
) -> FirstDivergence | None:
    if a is None or b is None:
        return None if a is b else FirstDivergence(time, f"{label}state", _known(a), _known(b))
    if a.names != b.names:
        return FirstDivergence(time, f"{label}names", a.names, b.names)
    kinds = ("width", "", "force") if label == "gripper " else ("position", "velocity", "effort")
    for kind, x, y in zip(
        kinds, (a.positions, a.velocities, a.efforts), (b.positions, b.velocities, b.efforts)
    ):
        if x.tobytes() == y.tobytes():
            continue
        if len(x) != len(y):
            return FirstDivergence(time, f"{label}{kind}", _known(x), _known(y))
        i = next(i for i in range(len(x)) if x[i : i + 1].tobytes() != y[i : i + 1].tobytes())
        return FirstDivergence(time, f"{label}{kind} of {a.names[i]}", float(x[i]), float(y[i]))
    return None


def _known(value: Any) -> str:
    return "not recorded" if value is None or len(value) == 0 else "recorded"


def _distances(pairs: list[tuple[RecordedState, RecordedState]]) -> tuple[Deviation, ...]:
    """Return the deviation of each joint and object that differs
    between two compared runs, largest deviation first.
    """
    found: dict[str, list[tuple[float, float]]] = {}
    for a, b in pairs:
        theirs = dict(zip(b.joints.names, b.joints.positions.tolist()))
        for name, value in zip(a.joints.names, a.joints.positions.tolist()):
            if name in theirs:
                found.setdefault(name, []).append((a.time, abs(value - theirs[name])))
        for name in a.poses:
            if name in b.poses:
                meters = float(np.linalg.norm(a.poses[name][:3] - b.poses[name][:3]))
                found.setdefault(name, []).append((a.time, meters))
    rows = []
    for name, course in found.items():
        at, largest = max(course, key=lambda row: row[1])
        if largest > 0:
            reached = ((x, next((t for t, d in course if d > x), None)) for x in THRESHOLDS)
            rows.append(Deviation(name, largest, at, tuple((x, t) for x, t in reached if t is not None)))
    return tuple(sorted(rows, key=lambda row: -row.largest))


# --- events, plans, outcome ---
def _data_divergence(a: Any, b: Any, path: str = "") -> tuple[str, Any, Any] | None:
    """Return the first difference between the event data of two compared runs.

    Returns:
        Path of the value ("stages[0].passed") and both values, or None.
    """
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        for key in dict.fromkeys((*a, *b)):
            here = f"{path}.{key}" if path else str(key)
            if key in TIMINGS:
                continue
            if key not in a or key not in b:
                return here, *(m.get(key, "not there") for m in (a, b))
            if (found := _data_divergence(a[key], b[key], here)) is not None:
                return found
        return None
    if isinstance(a, list | tuple) and isinstance(b, list | tuple):
        for i, (one, two) in enumerate(zip(a, b)):
            if (found := _data_divergence(one, two, f"{path}[{i}]")) is not None:
                return found
        return None if len(a) == len(b) else (f"number of {path}", len(a), len(b))
    same = a == b or (a != a and b != b)  # both NaN
    return None if same else (path, a, b)


def _compared(event: Event) -> Mapping[str, Any]:
    """Return the data of a recorded event that a comparison of two runs checks: all data except search
    statistics, which differ between runs.

    Planners with a time limit evaluate varying numbers of samples; the motion itself is compared separately.
    """
    return {k: v for k, v in event.data.items() if event.kind != "plan" or k != "evidence"}


def _event_divergence(a: Record, b: Record) -> FirstDivergence | None:
    def said(event: Event | None) -> str:
        return "nothing more" if event is None else f"{event.time:.3f} s {event.kind}: {event.text}"

    for i in range(max(len(a.events), len(b.events))):
        one, two = (r.events[i] if i < len(r.events) else None for r in (a, b))
        if one is None or two is None:
            if (a.cut and one is None) or (b.cut and two is None):
                return None  # missing values cannot be compared
            at = next(e.time for e in (one, two) if e is not None)
            return FirstDivergence(at, f"event {i + 1}", said(one), said(two))
        if (one.time, one.kind, one.text) != (two.time, two.kind, two.text):
            return FirstDivergence(one.time, f"event {i + 1}", said(one), said(two))
        if (found := _data_divergence(_compared(one), _compared(two))) is not None:
            path, first, second = found
            return FirstDivergence(
                one.time, f"{path} of event {i + 1} ({one.kind}: {one.text})", first, second
            )
    return None


def _plan_divergence(a: Record, b: Record) -> FirstDivergence | None:
    for i in range(max(len(a.trajectories), len(b.trajectories))):
        one, two = (r.trajectories[i] if i < len(r.trajectories) else None for r in (a, b))
        if one is None or two is None:
            if (a.cut and one is None) or (b.cut and two is None):
                return None
            at = next(p[0] for p in (one, two) if p is not None)
            return FirstDivergence(at, f"plan {i + 1}", _plan_words(one), _plan_words(two))
        if one[0] != two[0] or not _same_plan(one[1], two[1]):
            return FirstDivergence(one[0], f"plan {i + 1}", _plan_words(one), _plan_words(two))
    return None


def _same_plan(a: JointTrajectory, b: JointTrajectory) -> bool:
    def content(t: JointTrajectory) -> list[bytes | None]:
        arrays: tuple[Array | None, ...] = (t.times, t.positions, t.velocities, t.accelerations)
        return [None if x is None else x.tobytes() for x in arrays]

    return a.joint_names == b.joint_names and content(a) == content(b)


def _plan_words(plan: tuple[float, JointTrajectory] | None) -> str:
    if plan is None:
        return "none"
    way = float(np.abs(np.diff(plan[1].positions, axis=0)).sum())
    return f"{len(plan[1].times)} points, {plan[1].duration:.3f} s, {way:.3f} rad of way, at {plan[0]:.3f} s"


def _outcome_divergence(a: Mapping[str, Any] | None, b: Mapping[str, Any] | None) -> FirstDivergence | None:
    if a is None or b is None:
        return None
    at = max(float(r.get("task_time_s") or 0.0) for r in (a, b))
    for key in (
        "success",
        "error_name",
        "message",
        "task_time_s",
        "slip_m",
        "placement_error_m",
        "unwanted_contacts",
    ):
        one, two = a.get(key), b.get(key)
        if one != two:
            return FirstDivergence(at, key, one, two)
    return None
