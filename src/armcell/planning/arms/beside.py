"""One arm's motion beside the other's running one: as if it were alone, later, or searched in time."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from armcell.collision.arms import CLEARANCE, Arms, without_arm
from armcell.collision.kernel.checker import KernelChecker
from armcell.core import Contact, ErrorCode, InputError, JointTrajectory, Outcome, PlanRequest, PlanResult
from armcell.planning.arms.space_time import SpaceTimePath, SpaceTimeProblem, search, shortened
from armcell.planning.motion import joined, lead_in
from armcell.planning.moving import delayed
from armcell.planning.pipeline import Ends, find_ends, plan
from armcell.planning.question import ask
from armcell.scene import PlanningScene
from armcell.timing.averaged import averaged_pieces
from armcell.timing.chords import chords

Array = NDArray[np.float64]

WAIT_STEP = 0.1  # [s] between the waits that are tried
WINDOWS = (0.8, 0.4, 0.2)  # [s] of smoothing; the shorter, the slower and the nearer to the searched way
MARGIN = 0.02  # [m] that the search keeps beyond the clearance, for what smoothing cuts off
STEP = 0.03  # [rad] between samples of an edge against the world
THOROUGH, BRIEF = 30_000, 800  # iterations of a search for any way, and for an earlier arrival
SEARCHES = 3  # at most, each for an earlier arrival than the last


@dataclass(frozen=True, eq=False)
class RunningMotion:
    """What an arm does: a trajectory that began, or will begin, at `start` [s]; it stands still after it."""

    trajectory: JointTrajectory
    start: float = 0.0

    @property
    def end(self) -> float:
        return self.start + self.trajectory.duration

    @staticmethod
    def standing(scene: PlanningScene, group: str, time: float = 0.0) -> RunningMotion:
        """An arm that stays where the scene has it."""
        names = scene.model.group(group).joint_names
        q = scene.state.reindexed(names).positions[None]
        return RunningMotion(JointTrajectory(names, np.zeros(1), q, q * 0, q * 0), time)


def plan_beside(
    scene: PlanningScene,
    request: PlanRequest,
    other: str,
    running: RunningMotion,
    start_time: float = 0.0,
    clearance: float = CLEARANCE,
    cancel: threading.Event | None = None,
) -> PlanResult:
    """A motion of one arm that begins at `start_time`, proven to keep off the other arm's running motion.

    Args:
        scene: with the moving arm where it starts; where it has the other arm does not matter.
        other: the other arm's group. running: what it does; it must come to rest.
        start_time: [s] of the clock that `running.start` is on.
        clearance: to keep from the other arm and what it holds [m].
    Returns:
        As `plan`. `evidence["beside"]` is "as planned", "waits" or "searched"; waits are in the trajectory.
        On failure `evidence["contact"]` is the pair and `evidence["time"]` [s] when it would meet.
    Raises:
        InputError: misuse, see `plan`; groups that share joints.
    """
    began = time.monotonic()
    if not np.isfinite(start_time):
        raise InputError("start_time must be a finite number of seconds")
    arms = Arms(scene, (request.group, other))
    alone = without_arm(scene, other)
    first = plan(alone, request, cancel)
    if not first.ok or first.trajectory is None:
        return first
    board = _Board(arms, running, start_time, clearance)
    if (at := board.meets(first.trajectory)) is None:
        return _told(first, "as planned", began)
    start = first.trajectory.positions[0]
    contact = arms.contact(np.concatenate([start, board.other_at(start_time)]))
    if contact is not None and contact.distance < clearance:
        # It begins nearer than the clearance: what can be kept is a little less than there is.
        board = _Board(arms, running, start_time, max(contact.distance - 1e-3, 0.0))
        if board.meets(first.trajectory) is None:
            return _told(first, "as planned", began)
    waits = _waiting(board, first.trajectory)
    found = None if waits is None else replace(first, trajectory=waits)
    latest = np.inf if waits is None else start_time + waits.duration
    searched = _searched(alone, board, request, first, latest, began + request.planning_time, cancel)
    if searched is not None and start_time + searched.duration < latest:
        return _told(replace(first, trajectory=searched, path=None), "searched", began)
    if found is not None:
        return _told(found, "waits", began)
    pair, when = board.contact(first.trajectory, at), at
    text = "" if pair is None else f"{pair.body_a} would meet {pair.body_b} at {when:.2f} s; "
    return PlanResult(
        ErrorCode.PLANNING_FAILED,
        f"{text}no way was found in time and space that keeps {1000 * board.clearance:.0f} mm off {other!r}",
        {"contact": pair, "time": when},
        planner_id=first.planner_id,
        planning_time=time.monotonic() - began,
    )


def _told(result: PlanResult, how: str, began: float) -> PlanResult:
    spent = time.monotonic() - began
    return replace(result, evidence={**result.evidence, "beside": how}, planning_time=spent)


class _Board:
    """The other arm's motion as straight pieces on the clock, and questions about it."""

    def __init__(self, arms: Arms, running: RunningMotion, start_time: float, clearance: float):
        self.arms, self.running, self.start_time, self.clearance = arms, running, start_time, clearance
        end = max(running.end, start_time)
        self.times, self.points, self.room = chords((running.trajectory,), (running.start,), start_time, end)
        self.end = end
        self.dof = len(arms.joint_names) - self.points.shape[1]
        self._room = np.concatenate([np.zeros(self.dof), self.room])

    def other_at(self, t: float) -> Array:
        return np.array([np.interp(t, self.times, column) for column in self.points.T])

    def meets(self, trajectory: JointTrajectory) -> float | None:
        """When a motion from the start time on, and its rest, come nearer than the clearance; None if not."""
        found = self.arms.certify(
            trajectory, self.running.trajectory, (self.start_time, self.running.start), self.clearance,
            begin=self.start_time, until=max(self.end, self.start_time + trajectory.duration), evidence=False,
        )  # fmt: skip
        return None if found.free else found.time

    def contact(self, trajectory: JointTrajectory, at: float) -> Contact | None:
        """The nearest pair of bodies at a time of a motion that begins at the start time."""
        q = trajectory.sample(at - self.start_time)[0]
        return self.arms.contact(np.concatenate([q, self.other_at(at)]))

    def apart(self, p: Array, s: float, q: Array, t: float, more: float = 0.0) -> bool:
        """Whether a straight motion from (p, s) to (q, t) keeps the clearance and `more`."""
        inside = self.times[(self.times > s) & (self.times < t)]
        clock = np.concatenate([[s], inside, [t]]) if t > s else np.array([s])
        share = (clock - s) / (t - s) if t > s else np.zeros(1)
        points = np.empty((len(clock), self.dof + self.points.shape[1]))
        points[:, : self.dof] = p + share[:, None] * (q - p)
        for j in range(self.points.shape[1]):
            points[:, self.dof + j] = np.interp(clock, self.times, self.points[:, j])
        return self.arms.apart(points, self._room, self.clearance + more) < 0

    def free_from(self, q: Array, more: float) -> float:
        """From when on the arm may rest at q [s]; inf if the other comes to rest too near."""
        end = np.concatenate([q, self.points[-1]])[None]
        if self.arms.apart(end, None, self.clearance + more) >= 0:
            return np.inf
        points = np.hstack([np.tile(q, (len(self.times), 1)), self.points])[::-1]
        at = self.arms.first_near(points, self._room, self.clearance + more)
        return float(self.times[0] if at < 0 else self.times[len(self.times) - 1 - int(at)])


def _waiting(board: _Board, trajectory: JointTrajectory) -> JointTrajectory | None:
    """The same motion after the shortest wait that lets the other arm pass."""
    start = trajectory.positions[0]
    longest = board.end - board.start_time + WAIT_STEP
    for k in range(1, int(np.ceil(longest / WAIT_STEP)) + 1):
        wait = k * WAIT_STEP
        if not board.apart(start, board.start_time, start, board.start_time + wait):
            return None  # it cannot stay here so long
        later = delayed(trajectory, wait)
        if board.meets(later) is None:
            return later
    return None


class _Way:
    """Edges are free of the world at samples, and apart from the other arm for good."""

    def __init__(self, checker: KernelChecker, board: _Board, margin: float):
        self.checker, self.board, self.margin = checker, board, margin

    def free(self, p: Array, s: float, q: Array, t: float) -> bool:
        if not self.board.apart(p, s, q, t, self.margin):
            return False
        return bool(np.array_equal(p, q)) or self.checker.edge_is_free(p, q, STEP)


def _searched(
    alone: PlanningScene, board: _Board, request: PlanRequest, first: PlanResult, latest: float,
    deadline: float, cancel: threading.Event | None,
) -> JointTrajectory | None:  # fmt: skip
    """The earliest arrival that searches in time find before `latest` [s], as a proven smooth motion."""
    ends = find_ends(ask(alone, request, cancel))
    if isinstance(ends, Outcome) or first.trajectory is None:
        return None
    if ends.question.lead_in is None:
        return _earliest(alone, board, request, ends, latest, deadline, cancel)
    lead = lead_in(ends.question, ends.checker)  # out of resting contact; the search begins where it ends
    if lead is None:
        return None
    later = _Board(board.arms, board.running, board.start_time + lead.duration, board.clearance)
    found = _earliest(alone, later, request, ends, latest, deadline, cancel)
    whole = None if found is None else joined(lead, found)
    return whole if whole is not None and board.meets(whole) is None else None


def _earliest(
    alone: PlanningScene, board: _Board, request: PlanRequest, ends: Ends, latest: float, deadline: float,
    cancel: threading.Event | None,
) -> JointTrajectory | None:  # fmt: skip
    """See `_searched`; from the start of `ends`, at the board's start time."""
    names, model = ends.checker.joint_names, alone.model
    velocity = model.limits(names, "velocity") * request.velocity_scaling
    acceleration = model.limits(names, "acceleration") * request.acceleration_scaling
    rng = np.random.default_rng(request.seed)
    best: JointTrajectory | None = None
    horizon = latest
    iterations = THOROUGH if np.isinf(latest) else BRIEF
    for window in WINDOWS:
        margin = MARGIN * window / WINDOWS[0]
        if not board.apart(ends.start, board.start_time, ends.start, board.start_time, margin):
            margin = 0.0
        goals = np.array(ends.goals)
        problem = SpaceTimeProblem(
            _Way(ends.checker, board, margin), ends.start, board.start_time + window / 2, goals,
            np.array([board.free_from(g, margin) for g in goals]),
            np.minimum(velocity, acceleration * window),
            np.maximum(np.minimum(ends.lower, ends.start), ends.start - np.pi),
            np.minimum(np.maximum(ends.upper, ends.start), ends.start + np.pi),
        )  # fmt: skip
        arrivals = [problem.arrival(g) for g in range(len(goals))]
        if not np.isfinite(min(arrivals)):
            return best
        for _ in range(SEARCHES):
            if time.monotonic() > deadline or (cancel is not None and cancel.is_set()):
                return best
            at_most = min(horizon - window, _horizon(problem, board, arrivals))
            path = search(problem, at_most, rng, deadline, iterations)
            if path is None:
                break
            path = shortened(problem, path, rng, deadline)
            smooth = _smoothed(names, path, board.start_time, acceleration, ends.checker, board)
            if smooth is None:
                continue
            if board.start_time + smooth.duration < horizon:
                best, horizon, iterations = smooth, board.start_time + smooth.duration, BRIEF
        if best is not None:
            return best
    return best


def _horizon(problem: SpaceTimeProblem, board: _Board, arrivals: list[float]) -> float:
    """Latest arrival that is looked at [s]: some detour after the other arm has come to rest."""
    soonest = min(arrivals)
    return max(board.end, soonest) + 2.0 * (soonest - problem.start_time) + 1.0


def _smoothed(
    names: tuple[str, ...], path: SpaceTimePath, start_time: float, acceleration: Array,
    checker: KernelChecker, board: _Board,
) -> JointTrajectory | None:  # fmt: skip
    """The searched way as a smooth motion from `start_time` on, if that is proven free."""
    times, points = path.times, path.points
    keep = np.concatenate([[True], np.diff(times) > 1e-6])
    times, points = times[keep], points[keep]
    if len(times) < 2:
        return None
    try:
        smooth = averaged_pieces(names, times, points, acceleration)
    except InputError:
        return None
    window = smooth.duration - float(times[-1] - times[0])
    lead = float(times[0]) - window / 2 - start_time
    if lead < -1e-9:  # a wider window than thought: begin with the pieces later
        lead = 0.0
    if lead > 1e-6:
        smooth = delayed(smooth, lead)
    if board.meets(smooth) is not None:
        return None
    _, chain, room = chords((smooth,), (0.0,), 0.0, smooth.duration)
    return smooth if checker.certify(chain, room, evidence=False).free else None
