"""Planning of motions that satisfy path constraints everywhere, and its native RRT-Connect planner.

The planner searches on the constraint manifold; its kernels have a warm-up.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache, partial
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import (
    SE3,
    Box,
    ConstraintGoal,
    Constraints,
    ErrorCode,
    InputError,
    JointPath,
    JointTrajectory,
    Outcome,
    PlanRequest,
    PlanResult,
    PoseGoal,
    PositionConstraint,
)
from armcell.model import load_robot
from armcell.planning.certify import SAGITTA, clearance_along, complete_motion, torque_model
from armcell.planning.constraints.manifold import ConstraintManifold, Violation
from armcell.planning.constraints.rrt_connect import (
    Steps,
    closest_at,
    constrained_rrt_connect,
    space_size,
)
from armcell.planning.constraints.simplify import shorten
from armcell.planning.constraints.visibility_manifold import VisibilityManifold, make_manifold
from armcell.planning.goals.joint_goals import stream_goals
from armcell.planning.goals.sampling import reaches_goal, sample_goal_positions
from armcell.planning.planners.native.rrt_connect import ITERATIONS, Query
from armcell.planning.planners.problem import PlannerResult, Problem, sampling_bounds
from armcell.planning.planners.registry import announce_compilation, find_planner
from armcell.planning.planners.rrt_connect import (
    NativePlanner,
    RRTConnectSettings,
    planner_of,
    stop_flag,
    unsolved_result,
)
from armcell.planning.request import ValidatedRequest
from armcell.scene import PlanningScene
from armcell.timing import (
    BlendedPath,
    TimingSettings,
    TorqueLimitError,
    TorqueModel,
    jerk_limited,
    parameterize,
    smoothing_deviation,
)

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.


F64 = NDArray[np.float64]

SETTINGS = RRTConnectSettings(max_waypoints=4096)
logger = logging.getLogger(__name__)
LADDER = ((0.05, 0.032), (0.01, 0.032), (0.01, 0.016), (2e-3, 0.008), (5e-4, 4e-3))
"""Corner deviation [rad] and smoothing window [s]; the next pair is used if the previous one violates the
constraints or touches an obstacle. Smaller values make the motion slower and less smooth."""
PIECES = 4  # chords between two points of the trajectory, on which the constraints are proven
MAX_ROUNDS = 5  # attempts with other seeds if a path cannot be proven
MORE = 200  # further solutions of a pose goal to test if the first ones violate the constraints
PLANNER = "RRTConnect"


class ConstrainedPlanner(NativePlanner):
    """Planner for path constraints: a `NativePlanner` whose search trees and shortcuts stay on the constraint
    manifold.

    The planner reuses the trees of the current thread's planner.

    Args:
        rejection: reject samples and edges that leave the tolerances instead of projecting them (plain
            RRT-Connect, for comparison).
    """

    def __init__(self, native: NativePlanner, manifold: ConstraintManifold, rejection: bool = False):
        self.checker, self.settings, self.manifold = native.checker, SETTINGS, manifold
        self.reach, self.trees, self.found = native.reach, native.trees, native.found
        dof, m = manifold.dof, SETTINGS.max_waypoints
        self.path = np.zeros((m, dof))
        self.slack, self.ends = np.zeros(dof), np.zeros(space_size(dof))
        self.space, self.index = np.zeros((2 * m + 8) * dof + m), np.zeros(2 * m, np.int64)
        self.rejection = rejection
        self.bounds = (self.slack, self.slack)

    def search(
        self,
        start: F64,
        goals: F64,
        lower: F64,
        upper: F64,
        seed: int,
        stop: NDArray[np.int64],
        step: float,
        iterations: int | None = None,
        go_on: bool = False,
    ) -> tuple[int, int, int]:
        if not go_on:
            self.found[ITERATIONS] = 0
        self.bounds = (lower, upper)
        shift = np.random.default_rng(seed).random(len(start)) if seed else np.full(len(start), 0.5)
        delta = self.reach if self.rejection else self.manifold.step
        return constrained_rrt_connect(
            self.checker.handle, self.manifold.handle,
            Query(start, goals, lower, upper, shift, self.reach, step), delta, self.manifold.allowance,
            not self.rejection, self.trees, self.ends, self.found, stop,
            self.settings.max_iterations if iterations is None else iterations, self.path,
        )  # fmt: skip

    def shorten(self, count: int, stop: NDArray[np.int64]) -> int:
        """Shorten the path `path[:count]` that the planner for path constraints has found, in place.

        Return the new count, or 0 if a proof fails.
        """
        m = self.manifold
        rules = Steps(*self.bounds, self.slack, m.step, self.settings.step, m.allowance, True)
        return shorten(self.checker.handle, m.handle, self.path, count, self.space, self.index, rules, stop)

    @property
    def closest(self) -> F64 | None:
        dof = self.manifold.dof
        at = closest_at(dof)
        return self.ends[at + 1 :][: 2 * dof].reshape(2, dof).copy() if np.isfinite(self.ends[at]) else None


def constrained_planner(checker: KernelChecker, manifold: ConstraintManifold) -> ConstrainedPlanner:
    """Create a planner for path constraints that uses the search trees of the current thread."""
    return ConstrainedPlanner(planner_of(checker), manifold)


@lru_cache(maxsize=1)
def warm_up_constraints() -> float:
    """Warm up planning with path constraints: compile all its kernels before the first plan. Return the
    duration [s].
    """
    began = time.monotonic()
    announce_compilation("RRTConnect with path constraints", constrained_rrt_connect)
    model = load_robot("parallel_gripper")
    scene, group = PlanningScene.of(model), "gripper"
    finger = next(j.child for j in model.joints.values() if j.name in model.group(group).joint_names)
    anywhere = PositionConstraint(((Box(1.0, 1.0, 1.0), SE3.identity()),), finger)
    checker = KernelChecker(scene, model.group(group).joint_names)
    manifold = ConstraintManifold(scene, group, Constraints(positions=(anywhere,)))
    a, b = np.array([0.01]), np.array([0.04])
    manifold.values(a)
    manifold.first_unproven_edge(np.vstack([a, b]))
    manifold.project(a, a, b)
    constrained_planner(checker, manifold).plan(a, b[None], np.array([0.0]), np.array([0.05]))
    seconds = time.monotonic() - began
    if seconds > 2.0:
        logger.info("compiled planning with path constraints in %.0f s; it is kept for later runs", seconds)
    return seconds


def time_on_manifold(
    checker: KernelChecker, manifold: ConstraintManifold, waypoints: F64, request: PlanRequest,
    torque: TorqueModel | None = None,
) -> JointTrajectory | None:  # fmt: skip
    """Compute the timing of a planned path (k, n) with path constraints; return None if the timed motion
    cannot be proven to satisfy the constraints.
    """
    names, model = checker.joint_names, checker.model
    velocity = model.limits(names, "velocity") * request.velocity_scaling
    acceleration = model.limits(names, "acceleration") * request.acceleration_scaling
    for deviation, smoothing in LADDER:
        settings = TimingSettings(max_deviation=deviation, smoothing=smoothing)
        path = BlendedPath(waypoints, deviation, smooth=request.jerk_limits)
        slack = np.full(len(names), SAGITTA)
        if not request.jerk_limits:
            slack += smoothing_deviation(acceleration, settings)
        if path.length > 0 and not checker.certify(path.polyline(SAGITTA), slack, evidence=False).free:
            # With slack, a start or goal very close to an obstacle is not provable: last, try without slack.
            if (deviation, smoothing) != LADDER[-1]:
                continue
            if not checker.certify(path.polyline(SAGITTA), evidence=False).free:
                return None
        if request.jerk_limits:
            jerk = model.limits(names, "jerk")
            trajectory = jerk_limited(path, names, velocity, acceleration, jerk, settings)
        else:
            trajectory = parameterize(path, names, velocity, acceleration, settings, torque)
        if manifold.first_unproven_edge(*chords(trajectory)) < 0:
            return trajectory
    return None


def chords(trajectory: JointTrajectory) -> tuple[F64, F64]:
    """Approximate a planned motion with path constraints by chords (m, n), and bound the deviation (n,) [rad]
    of the motion from them.

    A curve deviates from its chord over a time h by at most h^2 / 8 times its largest acceleration. The
    acceleration of a quintic is a cubic, bounded by the hull of its Bernstein coefficients.
    """
    times, q = trajectory.times, trajectory.positions
    v, a = trajectory.velocities, trajectory.accelerations
    if len(times) == 1 or v is None or a is None:
        return np.vstack([q, q]), np.zeros(q.shape[1])
    h = np.diff(times)[:, None]
    d = np.diff(q, axis=0)
    v0, v1, a0, a1 = v[:-1], v[1:], a[:-1], a[1:]
    middle = 5 * d / h - 2 * (v0 + v1) + h * (a1 - a0) / 4  # of the velocity's Bernstein coefficients
    b1, b2 = 4 / h * (middle - v0 - h * a0 / 4), 4 / h * (v1 - h * a1 / 4 - middle)  # the acceleration's
    most = np.max(np.abs(np.stack([a0, b1, b2, a1])), axis=0)
    room = np.max(most * (h / PIECES) ** 2 / 8, axis=0)
    control = np.stack([  # of the quintic
        q[:-1], q[:-1] + h * v0 / 5, q[:-1] + 2 * h * v0 / 5 + h * h * a0 / 20,
        q[1:] - 2 * h * v1 / 5 + h * h * a1 / 20, q[1:] - h * v1 / 5, q[1:],
    ])  # fmt: skip
    s = np.arange(PIECES)[:, None] / PIECES
    basis = np.hstack([n * s**i * (1 - s) ** (5 - i) for i, n in enumerate((1, 5, 10, 10, 5, 1))])
    points = np.einsum("pc,cin->ipn", basis, control).reshape(-1, q.shape[1])
    return np.vstack([points, q[-1]]), room


def check_planner(validated: ValidatedRequest) -> None:
    """Raise an InputError if a request has path constraints but
    selects a planner that does not support them.
    """
    pipeline_id = validated.request.pipeline_id or "native"
    if pipeline_id != "native" or validated.planner_id != PLANNER:
        raise InputError(
            f"planner {validated.planner_id!r} of pipeline {pipeline_id!r} cannot keep to path constraints",
            hint=f"pipeline_id='native' with planner_id={PLANNER!r} can",
        )


def plan_constrained(
    validated: ValidatedRequest, checker: KernelChecker, start: F64, goals: tuple[F64, ...]
) -> PlanResult:
    """Plan a certified motion with timing that is proven to satisfy its path constraints everywhere.

    Args:
        start: (n,), collision-free. goals: (n,) collision-free goals found so far.
    Raises:
        InputError: invalid constraints.
    """
    compiling = time.monotonic()
    warm_up_constraints()
    compiling = time.monotonic() - compiling
    validated = replace(
        validated, began=validated.began + compiling
    )  # compilation does not count as planning time
    scene, request = validated.scene, validated.request
    manifold = make_manifold(scene, request.group, request.path_constraints)
    standing = start if validated.lead_in is None else validated.lead_in[0]
    if violations := manifold.violations(standing) or manifold.violations(start):
        return validated.failed(
            _violated(ErrorCode.START_STATE_VIOLATES_PATH_CONSTRAINTS, "start", violations)
        )
    good, violations = _goals(validated, checker, manifold, goals)
    if not good:
        return validated.failed(_violated(ErrorCode.GOAL_VIOLATES_PATH_CONSTRAINTS, "goal", violations))
    manifold.relax_boundary([start, *good])
    lower, upper = sampling_bounds(scene.model, checker.joint_names, start, good)
    lower = np.maximum(lower, np.minimum(manifold.lower, start))
    upper = np.minimum(upper, np.maximum(manifold.upper, start))
    results = []
    for number in range(int(request.attempts)):
        seed = request.seed + 104_729 * number
        problem = Problem(checker, start, good, lower, upper, seed, validated.deadline, validated.cancel)
        results.append(_attempt(validated, manifold, problem))
    return min(results, key=lambda r: r.path.length if r.path is not None else np.inf)


def _attempt(validated: ValidatedRequest, manifold: ConstraintManifold, problem: Problem) -> PlanResult:
    """Search for paths that satisfy the path constraints until one of them can be certified and its timing
    computed.
    """
    request, checker = validated.request, problem.checker
    torque = torque_model(validated.scene, checker.joint_names) if request.torque_limits else None
    answer, why = None, "found paths, but none whose timed motion could be proven to keep to the constraints"
    for round_ in range(MAX_ROUNDS):
        seed = problem.seed + 7919 * round_
        waypoints = _direct(problem, manifold) if round_ == 0 else None
        if waypoints is None:
            answer = _searched(validated, manifold, replace(problem, seed=seed))
            waypoints = answer.waypoints
            if waypoints is None:
                break
        if validated.cancel.is_set():
            break
        if (
            validated.workspace is not None
            and (q := validated.workspace.first_outside(waypoints)) is not None
        ):
            why = f"the paths found leave the workspace: {validated.workspace.describe(q)}"
            continue
        try:
            trajectory = time_on_manifold(checker, manifold, waypoints, request, torque)
        except TorqueLimitError as error:
            evidence = {"joint": error.joint, "torque": error.torque, "limit": error.limit}
            return validated.failed(Outcome(ErrorCode.PLANNING_FAILED, str(error), evidence))
        if trajectory is None:
            continue
        made = complete_motion(validated, checker, waypoints, trajectory)
        return PlanResult(
            ErrorCode.SUCCESS,
            made.note,
            {**validated.evidence, **(answer.statistics if answer else {})},
            path=JointPath(checker.joint_names, made.waypoints),
            trajectory=made.trajectory,
            planner_id=PLANNER,
            planning_time=time.monotonic() - validated.began,
            clearance=None if made.trajectory is None else partial(clearance_along, checker, made.trajectory),
        )
    return validated.failed(_unsolved(validated, problem, answer, why))


def _searched(validated: ValidatedRequest, manifold: ConstraintManifold, problem: Problem) -> PlannerResult:
    """Search for a path to the goals that satisfies the path constraints, or report why none was found."""
    if isinstance(manifold, VisibilityManifold):  # visibility has no projection: OMPL rejects invalid samples
        return find_planner("ompl", PLANNER)(replace(problem, forbids=manifold.forbids))
    planner = constrained_planner(problem.checker, manifold)
    more = _more(validated, problem.checker, manifold, problem.goals, problem.seed)
    with stop_flag(problem) as stop:
        found = planner.plan(
            problem.start, np.vstack(problem.goals), problem.lower, problem.upper, problem.seed, stop,
            more_goals=more,
        )  # fmt: skip
    statistics: dict[str, Any] = {
        "iterations": float(found.iterations),
        "nodes": float(found.nodes),
        "plan_us": found.plan_s * 1e6,
        "simplify_us": found.simplify_s * 1e6,
    }
    if found.waypoints is None:
        return unsolved_result(PLANNER, problem, found.iterations, found.closest, statistics)
    return PlannerResult(found.waypoints, "", statistics)


def _unsolved(
    validated: ValidatedRequest, problem: Problem, answer: PlannerResult | None, why: str
) -> Outcome:
    cancelled = validated.cancel.is_set()
    timed_out = time.monotonic() >= validated.deadline
    code = (
        ErrorCode.PREEMPTED if cancelled else ErrorCode.TIMED_OUT if timed_out else ErrorCode.PLANNING_FAILED
    )
    if answer is None or answer.waypoints is not None:
        message = f"{PLANNER}: cancelled" if cancelled else why
    else:
        message = f"{answer.message}, with the path constraints kept"
    statistics = {} if answer is None else answer.statistics
    return Outcome(code, message, {"goals": len(problem.goals), **statistics})


def _violated(code: ErrorCode, what: str, violations: list[Violation]) -> Outcome:
    text = f"{what} violates the path constraints: " + "; ".join(v.text for v in violations[:3])
    return Outcome(code, text, {"violations": violations})


def _direct(problem: Problem, manifold: ConstraintManifold) -> F64 | None:
    """Plan a straight line to a goal: return it if it is collision-free and satisfies the path
    constraints.
    """
    for goal in problem.goals:
        if np.max(np.abs(goal - problem.start)) < 1e-9:
            return np.vstack([problem.start])
        edge = np.vstack([problem.start, goal])
        free = manifold.first_unproven_edge(edge) < 0 and problem.checker.edge_is_free(problem.start, goal)
        if free and problem.checker.certify(edge, evidence=False).free:
            return edge
    return None


def _goals(
    validated: ValidatedRequest,
    checker: KernelChecker,
    manifold: ConstraintManifold,
    found: tuple[F64, ...],
) -> tuple[tuple[F64, ...], list[Violation]]:
    """Select the goals for planning with path constraints: those that satisfy the constraints.

    If there are none, project further goal samples onto the constraints; if this fails, return the
    violations.
    """
    good = tuple(q for q in found if not manifold.violations(q))
    if good:
        return good, []
    first = next(islice(_moved(validated, checker, manifold), 1), None)
    if first is not None:
        return (first,), []
    return (), min((manifold.violations(q) for q in found), key=lambda some: max(v.amount for v in some))


def _moved(
    validated: ValidatedRequest, checker: KernelChecker, manifold: ConstraintManifold
) -> Iterator[F64]:
    """Yield collision-free goals for planning with path constraints, after projecting them so that they
    satisfy the constraints.
    """
    scene, request = validated.scene, validated.request
    rng = np.random.default_rng([request.seed, 2])
    low = np.maximum(scene.model.lower[checker.columns], manifold.lower)
    high = np.minimum(scene.model.upper[checker.columns], manifold.upper)
    for goal in request.goals:
        if not isinstance(goal, PoseGoal | ConstraintGoal):
            continue
        for q in islice(sample_goal_positions(scene, request.group, goal, rng, validated.deadline), MORE):
            moved = q if not manifold.violations(q) else manifold.project(q, low, high)
            if moved is None or not checker.is_free(moved) or validated.forbids(moved):
                continue
            if reaches_goal(scene, request.group, goal, moved):
                yield moved


def _more(
    validated: ValidatedRequest,
    checker: KernelChecker,
    manifold: ConstraintManifold,
    known: tuple[F64, ...],
    seed: int,
) -> Iterator[F64] | None:
    """Yield further goals that satisfy the path constraints, while the search for a path is running."""
    more = stream_goals(validated, checker, known, seed)
    return None if more is None else (q for q in more if not manifold.violations(q))
