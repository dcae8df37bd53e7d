"""Planning of one arm's motion around the running motions of the other arms.

The planner returns the motion unchanged, delayed, or searched in joint positions and time.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from armcell.collision.inter_arm_checker import CLEARANCE, InterArmChecker, without_arms
from armcell.collision.kernel.checker import KernelChecker
from armcell.core import Contact, ErrorCode, InputError, JointTrajectory, Outcome, PlanRequest, PlanResult
from armcell.planning.certify import time_lead_in
from armcell.planning.multi_arm.space_time_search import SpaceTimePath, SpaceTimeProblem, search, shortened
from armcell.planning.pipeline import StartAndGoals, find_start_and_goals, plan
from armcell.planning.request import validate_request
from armcell.scene import PlanningScene
from armcell.timing import concatenate_trajectories, delay_trajectory, stationary_trajectory
from armcell.timing.chords import chords
from armcell.timing.moving_average import smooth_by_moving_average

Array = NDArray[np.float64]

WAIT_STEP = 0.1  # [s] increment of waits
WINDOWS = (0.8, 0.4, 0.2)  # [s] smoothing windows; shorter ones follow the path more closely but are slower
MARGIN = 0.02  # [m] added to the clearance while searching, for corners that smoothing cuts
STEP = 0.03  # [rad] between samples of an edge against the world
THOROUGH, BRIEF = 30_000, 800  # iterations of the search for a first path, and for an earlier arrival
SEARCHES = 3  # searches, each for an earlier arrival than the last


@dataclass(frozen=True, eq=False)
class RunningMotion:
    """Motion of a moving arm that a plan for another arm must avoid; it begins at time `start` [s], in
    the past or in the future.

    The arm rests after the end of the motion.
    """

    trajectory: JointTrajectory
    start: float = 0.0

    @property
    def end(self) -> float:
        """Time [s] at which the running motion of the moving arm ends."""
        return self.start + self.trajectory.duration

    @staticmethod
    def at_rest(scene: PlanningScene, group: str, time: float = 0.0) -> RunningMotion:
        """Create a `RunningMotion` for an arm at rest: the arm keeps its joint positions from the scene."""
        names = scene.model.group(group).joint_names
        return RunningMotion(stationary_trajectory(names, scene.state.reindexed(names).positions), time)


def plan_around_moving_arms(
    scene: PlanningScene,
    request: PlanRequest,
    others: Mapping[str, RunningMotion],
    start_time: float = 0.0,
    clearance: float = CLEARANCE,
    cancel: threading.Event | None = None,
) -> PlanResult:
    """Plan a motion of one arm that is proven to avoid other arms while they are moving.

    Args:
        scene: scene with the planned arm at its start; the positions of the other arms do not matter.
        others: the motion of each other arm by its group; it must come to rest.
        start_time: start of the planned motion [s] on the clock of `RunningMotion.start`.
        clearance: distance to the other arms and their attached objects [m].
    Returns:
        Like `plan`. `evidence["beside"]` is "as planned", "waits" or "searched"; the trajectory includes
        waits. On failure `evidence["contact"]` is the pair of bodies that would touch and
        `evidence["time"]` the time [s] of the contact.
    Raises:
        InputError: misuse, see `plan`; groups that share joints.
    """
    began = time.monotonic()
    if not isinstance(others, Mapping):
        raise InputError("others must be a dict", hint="give each other arm's running motion by its group")
    if not np.isfinite(start_time):
        raise InputError("start_time must be a finite number of seconds")
    arms = InterArmChecker(scene, (request.group, *others), request.group)
    alone = without_arms(scene, *others)
    first = plan(alone, request, cancel)
    if not first.ok or first.trajectory is None:
        return first
    running = tuple(others.values())
    timeline = MovingArmTimeline(arms, running, start_time, clearance)
    if (at := timeline.first_conflict(first.trajectory)) is None:
        return _with_strategy(first, "as planned", began)
    start = first.trajectory.positions[0]
    contact = arms.contact(np.concatenate([start, timeline.others_at(start_time)]))
    if contact is not None and contact.distance < clearance:
        # The arms start closer than the clearance: keep slightly less than the start distance.
        timeline = MovingArmTimeline(arms, running, start_time, max(contact.distance - 1e-3, 0.0))
        if timeline.first_conflict(first.trajectory) is None:
            return _with_strategy(first, "as planned", began)
    waits = _waiting(timeline, first.trajectory)
    found = None if waits is None else replace(first, trajectory=waits)
    latest = np.inf if waits is None else start_time + waits.duration
    searched = _searched(alone, timeline, request, first, latest, began + request.planning_time, cancel)
    if searched is not None and start_time + searched.duration < latest:
        return _with_strategy(replace(first, trajectory=searched, path=None), "searched", began)
    if found is not None:
        return _with_strategy(found, "waits", began)
    pair, when = timeline.contact(first.trajectory, at), at
    text = "" if pair is None else f"{pair.body_a} would meet {pair.body_b} at {when:.2f} s; "
    return PlanResult(
        ErrorCode.PLANNING_FAILED,
        f"{text}no path in space and time was found that keeps "
        f"{1000 * timeline.clearance:.0f} mm off {' and '.join(map(repr, others))}",
        {"contact": pair, "time": when},
        planner_id=first.planner_id,
        planning_time=time.monotonic() - began,
    )


def _with_strategy(result: PlanResult, how: str, began: float) -> PlanResult:
    spent = time.monotonic() - began
    return replace(result, evidence={**result.evidence, "beside": how}, planning_time=spent)


class MovingArmTimeline:
    """Timeline of the moving arms' motions, approximated by straight pieces. It checks whether a planned
    motion keeps enough clearance to these arms.
    """

    def __init__(
        self, arms: InterArmChecker, running: tuple[RunningMotion, ...], start_time: float, clearance: float
    ):  # fmt: skip
        self.arms, self.running, self.start_time, self.clearance = arms, running, start_time, clearance
        self.motions, self.starts = tuple(m.trajectory for m in running), tuple(m.start for m in running)
        self.end = max(start_time, *(m.end for m in running))
        self.times, self.points, self.room = chords(self.motions, self.starts, start_time, self.end)
        self.dof = len(arms.joint_names) - self.points.shape[1]
        self._room = np.concatenate([np.zeros(self.dof), self.room])

    def others_at(self, t: float) -> Array:
        """Return the joint positions of the moving arms at a time [s], interpolated on their timeline."""
        return np.array([np.interp(t, self.times, column) for column in self.points.T])

    def first_conflict(self, trajectory: JointTrajectory) -> float | None:
        """Return the first time [s] at which a planned motion comes closer to a moving arm than the
        clearance allows, or None.

        The arm rests after its motion. None if the motion and the rest keep the clearance.
        """
        found = self.arms.certify(
            trajectory, *self.motions, starts=(self.start_time, *self.starts), clearance=self.clearance,
            begin=self.start_time, until=max(self.end, self.start_time + trajectory.duration), evidence=False,
        )  # fmt: skip
        return None if found.free else found.time

    def contact(self, trajectory: JointTrajectory, at: float) -> Contact | None:
        """Find the bodies of the planned arm and a moving arm that are nearest to each other at a time [s]
        of the planned motion.
        """
        q = trajectory.sample(at - self.start_time)[0]
        return self.arms.contact(np.concatenate([q, self.others_at(at)]))

    def keeps_clearance(self, p: Array, s: float, q: Array, t: float, more: float = 0.0) -> bool:
        """Return whether a straight joint motion, from p (n,) at time s [s] to q (n,) at time t [s], keeps
        the clearance to the moving arms. `more` [m] is added to the required clearance.
        """
        inside = self.times[(self.times > s) & (self.times < t)]
        clock = np.concatenate([[s], inside, [t]]) if t > s else np.array([s])
        share = (clock - s) / (t - s) if t > s else np.zeros(1)
        points = np.empty((len(clock), self.dof + self.points.shape[1]))
        points[:, : self.dof] = p + share[:, None] * (q - p)
        for j in range(self.points.shape[1]):
            points[:, self.dof + j] = np.interp(clock, self.times, self.points[:, j])
        return self.arms.find_too_close(points, self._room, self.clearance + more) < 0

    def free_after(self, q: Array, more: float) -> float:
        """Return the time [s] from which the planned arm can stay at q, clear of the moving arms.

        The time is infinite if a moving arm comes to rest too close to q.
        """
        end = np.concatenate([q, self.points[-1]])[None]
        if self.arms.find_too_close(end, None, self.clearance + more) >= 0:
            return np.inf
        points = np.hstack([np.tile(q, (len(self.times), 1)), self.points])[::-1]
        at = self.arms.first_too_close(points, self._room, self.clearance + more)
        return float(self.times[0] if at < 0 else self.times[len(self.times) - 1 - int(at)])


def _waiting(timeline: MovingArmTimeline, trajectory: JointTrajectory) -> JointTrajectory | None:
    """Delay a motion until the moving arms have passed; the wait is as short as possible. Return None if no
    wait helps.
    """
    start = trajectory.positions[0]
    longest = timeline.end - timeline.start_time + WAIT_STEP
    for k in range(1, int(np.ceil(longest / WAIT_STEP)) + 1):
        wait = k * WAIT_STEP
        if not timeline.keeps_clearance(start, timeline.start_time, start, timeline.start_time + wait):
            return None  # the arm cannot wait here that long
        later = delay_trajectory(trajectory, wait)
        if timeline.first_conflict(later) is None:
            return later
    return None


class _TimelineValidity:
    """Validity check for edges in joint space and time when one arm plans around moving arms. Samples must be
    collision-free, and the clearance to the moving arms must be proven.
    """

    def __init__(self, checker: KernelChecker, timeline: MovingArmTimeline, margin: float):
        self.checker, self.timeline, self.margin = checker, timeline, margin

    def free(self, p: Array, s: float, q: Array, t: float) -> bool:
        if not self.timeline.keeps_clearance(p, s, q, t, self.margin):
            return False
        return bool(np.array_equal(p, q)) or self.checker.edge_is_free(p, q, STEP)


def _searched(
    alone: PlanningScene, timeline: MovingArmTimeline, request: PlanRequest, first: PlanResult, latest: float,
    deadline: float, cancel: threading.Event | None,
) -> JointTrajectory | None:  # fmt: skip
    """Plan one arm's motion around the moving arms by a search in joint space and time.

    The motion must reach a goal before time `latest` [s], as early as possible. Return a certified smooth
    motion, or None if the search finds none.
    """
    endpoints = find_start_and_goals(validate_request(alone, request, cancel))
    if isinstance(endpoints, Outcome) or first.trajectory is None:
        return None
    if endpoints.validated.lead_in is None:
        return _earliest(alone, timeline, request, endpoints, latest, deadline, cancel)
    lead = time_lead_in(
        endpoints.validated, endpoints.checker
    )  # out of resting contact; the search begins at its end
    if lead is None:
        return None
    later = MovingArmTimeline(
        timeline.arms, timeline.running, timeline.start_time + lead.duration, timeline.clearance
    )
    found = _earliest(alone, later, request, endpoints, latest, deadline, cancel)
    whole = None if found is None else concatenate_trajectories(lead, found)
    return whole if whole is not None and timeline.first_conflict(whole) is None else None


def _earliest(
    alone: PlanningScene, timeline: MovingArmTimeline, request: PlanRequest, endpoints: StartAndGoals,
    latest: float, deadline: float,
    cancel: threading.Event | None,
) -> JointTrajectory | None:  # fmt: skip
    """Plan one arm's motion around moving arms so that it reaches a goal as early as possible, by repeated
    searches in joint space and time.

    Return a certified smooth motion that arrives before `latest` [s], or None. See `_searched`.
    """
    names, model = endpoints.checker.joint_names, alone.model
    velocity = model.limits(names, "velocity") * request.velocity_scaling
    acceleration = model.limits(names, "acceleration") * request.acceleration_scaling
    rng = np.random.default_rng(request.seed)
    best: JointTrajectory | None = None
    horizon = latest
    iterations = THOROUGH if np.isinf(latest) else BRIEF
    for window in WINDOWS:
        margin = MARGIN * window / WINDOWS[0]
        if not timeline.keeps_clearance(
            endpoints.start, timeline.start_time, endpoints.start, timeline.start_time, margin
        ):
            margin = 0.0
        goals = np.array(endpoints.goals)
        problem = SpaceTimeProblem(
            _TimelineValidity(endpoints.checker, timeline, margin), endpoints.start,
            timeline.start_time + window / 2, goals,
            np.array([timeline.free_after(g, margin) for g in goals]),
            np.minimum(velocity, acceleration * window),
            np.maximum(np.minimum(endpoints.lower, endpoints.start), endpoints.start - np.pi),
            np.minimum(np.maximum(endpoints.upper, endpoints.start), endpoints.start + np.pi),
        )  # fmt: skip
        arrivals = [problem.arrival(g) for g in range(len(goals))]
        if not np.isfinite(min(arrivals)):
            return best
        for _ in range(SEARCHES):
            if time.monotonic() > deadline or (cancel is not None and cancel.is_set()):
                return best
            at_most = min(horizon - window, _horizon(problem, timeline, arrivals))
            path = search(problem, at_most, rng, deadline, iterations)
            if path is None:
                break
            path = shortened(problem, path, rng, deadline)
            smooth = _smoothed(names, path, timeline.start_time, acceleration, endpoints.checker, timeline)
            if smooth is None:
                continue
            if timeline.start_time + smooth.duration < horizon:
                best, horizon, iterations = smooth, timeline.start_time + smooth.duration, BRIEF
        if best is not None:
            return best
    return best


def _horizon(problem: SpaceTimeProblem, timeline: MovingArmTimeline, arrivals: list[float]) -> float:
    """Compute the arrival time [s] at which the space-time search gives up: it considers no motion that
    reaches the goal later.

    The time suffices for a detour after the other arms have come to rest.
    """
    soonest = min(arrivals)
    return max(timeline.end, soonest) + 2.0 * (soonest - problem.start_time) + 1.0


def _smoothed(
    names: tuple[str, ...], path: SpaceTimePath, start_time: float, acceleration: Array,
    checker: KernelChecker, timeline: MovingArmTimeline,
) -> JointTrajectory | None:  # fmt: skip
    """Smooth a path in joint space and time around the moving arms.
    Return the motion if it can be certified, else None.
    """
    times, points = path.times, path.points
    keep = np.concatenate([[True], np.diff(times) > 1e-6])
    times, points = times[keep], points[keep]
    if len(times) < 2:
        return None
    try:
        smooth = smooth_by_moving_average(names, times, points, acceleration)
    except InputError:
        return None
    window = smooth.duration - float(times[-1] - times[0])
    lead = float(times[0]) - window / 2 - start_time
    if lead < -1e-9:  # a wider window than assumed: begin later
        lead = 0.0
    if lead > 1e-6:
        smooth = delay_trajectory(smooth, lead)
    if timeline.first_conflict(smooth) is not None:
        return None
    _, chain, room = chords((smooth,), (0.0,), 0.0, smooth.duration)
    return smooth if checker.certify(chain, room, evidence=False).free else None
