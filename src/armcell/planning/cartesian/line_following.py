"""Step-by-step inverse kinematics along a straight line, redundancy resolution, reasons why a line stops.

Each step is a descent from the previous joint positions. A redundant arm may meanwhile move along its
null space: away from joint limits, or along the solution that `plan_redundancy` finds. An arm without
redundant joints has a single solution to follow.

All joint solutions of a pose that are reachable without a jump form a curve, the null space. The search
for the redundancy cuts the line coarsely and keeps, at each cut, one configuration per stretch of this
curve. It continues from each configuration by staying or by moving one stretch to either side (dynamic
programming as over Descartes' ladder graph, but restricted to the curve through the start). The fine
steps are then pulled toward the cheapest solution.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.resting_contact import SeparationChecker, resting_pairs, with_allowed_contacts
from armcell.core import SE3, CartesianRequest, Contact, ErrorCode
from armcell.kinematics import IKSolver
from armcell.planning.constraints.manifold import ConstraintManifold, Violation

F64 = NDArray[np.float64]

STRIDE = 4  # steps of the line between two cuts
STRETCH = 0.15  # [rad or m] of the joint that moves most along the null space
WIDEST = 16  # stretches to either side of the start
LARGEST = 0.6  # [rad or m] largest joint step between two cuts; a larger step means another branch
NEAR_LIMIT = 0.2  # weight of nearness to a limit relative to squared joint motion
SINGULAR = 0.05  # smallest singular value of the Jacobian [m, rad], far below normal values
LEAD_OUT = (
    "the line begins in contact and does not lead out of it: begin with a waypoint a few millimeters off "
    "what it touches, or allow the contact"
)
JointPreference = Callable[
    [F64, int], F64
]  # (positions (n,), number of the step) -> desired change of the positions (n,)
TASK = 6  # degrees of freedom of a pose; further joints are redundant
GAIN = 0.15  # share of the zone by which a joint moves away per step
FASTEST = 0.05  # [rad or m] largest null-space motion in one step


@dataclass(frozen=True, eq=False)
class _Node:
    q: F64  # (n,)
    along: F64  # (n,) null-space direction, with the same orientation at all cuts
    cost: float
    before: _Node | None


def plan_redundancy(
    ik: IKSolver,
    poses: list[SE3],
    start: F64,
    rest: F64,
    bounds: F64,
    zone: F64,
    allowed: Callable[[F64], bool],
) -> F64 | None:
    """Choose how a redundant arm moves along a line. Return joint positions (len(poses), n) that guide the
    arm, or None if no suitable motion exists.

    Args:
        start: (n,). rest: (dof,) of all joints. bounds: (n, 2) joint limits. zone: (n,) distance from the
            limits that is penalized.
        allowed: returns whether the arm may be at positions (n,).
    """
    cuts = [*range(STRIDE - 1, len(poses) - 1, STRIDE), len(poses) - 1]
    full = rest.copy()
    full[ik.columns] = start
    layer = {0: _Node(start, _null(ik, full, None), 0.0, None)}
    for cut in cuts:
        found: dict[int, _Node] = {}
        for number, node in layer.items():
            for side in (0, -1, 1):
                at = number + side
                if abs(at) > WIDEST:
                    continue
                full[ik.columns] = node.q
                if not ik.descend(full, poses[cut], wish=side * STRETCH * node.along, bounds=bounds)[2]:
                    continue
                q = full[ik.columns].copy()
                moved = q - node.q
                if np.max(np.abs(moved)) > LARGEST:
                    continue
                inside = np.minimum(q - bounds[:, 0], bounds[:, 1] - q)
                near = np.maximum(1.0 - inside / np.maximum(zone, 1e-9), 0.0)
                cost = node.cost + float(moved @ moved) + NEAR_LIMIT * float(near @ near)
                if (at in found and found[at].cost <= cost) or not allowed(q):
                    continue
                found[at] = _Node(q, _null(ik, full, node.along), cost, node)
        if not found:
            return None
        layer = found
    return _between(min(layer.values(), key=lambda node: node.cost), cuts, len(poses))


def _null(ik: IKSolver, full: F64, like: F64 | None) -> F64:
    """Compute the null-space direction (n,) in which a redundant arm can move while following a line, because
    the tip stays in place. The largest component has magnitude 1, and the direction does not point against
    `like`.
    """
    J = ik.tree.jacobian(full, ik.tip_link, ik.joint_names)
    along = np.linalg.svd(J)[2][-1]
    along = along / np.max(np.abs(along))
    return -along if like is not None and along @ like < 0 else along


def _between(last: _Node, cuts: list[int], count: int) -> F64:
    """Interpolate the joint positions of a redundant arm between the configurations that the search chose at
    the steps `cuts`, to follow a line. Return the joint positions (count, n) of all steps.
    """
    nodes: list[F64] = []
    node: _Node | None = last
    while node is not None:
        nodes.append(node.q)
        node = node.before
    points = np.array(nodes[::-1])
    at = np.array([-1, *cuts])
    steps = np.arange(count)
    return np.column_stack([np.interp(steps, at, points[:, j]) for j in range(points.shape[1])])


COLLISION, CONSTRAINT, JUMP, LIMIT, REACH, SINGULARITY, BRANCH = (
    "collision", "path constraint", "jump", "joint limit", "out of reach", "singularity", "no way on",
)  # fmt: skip


TURNING, SLIDING, RELATIVE = "jump_threshold", "prismatic_jump_threshold", "relative_jump_threshold"
"""Names of the request's jump thresholds."""


@dataclass(frozen=True, eq=False)
class Stop:
    """First step at which the robot cannot continue to follow a Cartesian line.

    Attributes:
        explain: computes the reason with its evidence; called only for the best of all attempts.
    """

    explain: Callable[[], StopReason]


@dataclass(frozen=True, eq=False)
class StopReason:
    """Reason why a robot cannot follow a Cartesian line to its end: cause, text, error code and evidence.

    The cause is one of the constants above.
    """

    cause: str
    text: str
    code: ErrorCode
    evidence: dict[str, Any] = field(default_factory=dict)


def collision_stop(contacts: list[Contact]) -> StopReason:
    """Return the reason why the robot stops following a Cartesian line: bodies would collide."""
    text = "; ".join(c.describe() for c in contacts[:3]) or "in collision"
    return StopReason(COLLISION, text, ErrorCode.INVALID_MOTION_PLAN, {"contacts": contacts})


def jump_stop(joint: str, step: float, threshold: float, field: str, unit: str) -> StopReason:
    """Return the reason why the robot stops following a Cartesian line: a joint would jump.

    Args:
        threshold: jump threshold of the request, in `unit` or as a factor.
        field: the request field that holds the threshold.
    """
    what = f"{threshold:g} times the mean step" if field == RELATIVE else f"threshold {threshold:g}"
    text = f"{joint} would jump {step:.2f} {unit} ({what})"
    return StopReason(JUMP, text, ErrorCode.PLANNING_FAILED, {"joint": joint, "step": step, "field": field})


def at_violation(manifold: ConstraintManifold, q: F64) -> list[Violation]:
    """List the constraints that the robot violates, or satisfies with too small a margin, at positions q (n,)
    while following a Cartesian line.
    """
    return manifold.violations(q, inside=manifold.allowance == 0.0)


def constraint_stop(manifold: ConstraintManifold, q: F64) -> StopReason:
    """Return the reason why the robot stops following a Cartesian line: it would violate path constraints."""
    found = at_violation(manifold, q)
    words = [
        v.text
        if v.amount > manifold.boundary_margin
        else f"{v.name} comes to the edge of its {v.kind} constraint"
        for v in found[:3]
    ]
    text = "; ".join(words) or "the motion between two steps leaves the path constraints"
    evidence = {"violations": found, "constraints": [v.name for v in found]}
    return StopReason(CONSTRAINT, text, ErrorCode.INVALID_MOTION_PLAN, evidence)


def ik_stop(
    ik: IKSolver, pose: SE3, before: F64, closest: F64, short: tuple[float, float], limits: list[str]
) -> StopReason:
    """Return the reason why the robot stops following a Cartesian line: inverse kinematics has no suitable
    solution.

    The cause is a joint limit, an unreachable pose, a singularity or a change to another branch.

    Args:
        before: positions (dof,) of the last feasible step. closest: positions (dof,) nearest to the pose.
        short: missing distance [m] and angle [rad] at `closest`. limits: joints at their limits at `closest`.
    """
    J = ik.tree.jacobian(closest, ik.tip_link, ik.joint_names)
    least = float(np.linalg.svd(J, compute_uv=False)[-1])
    evidence: dict[str, Any] = {
        "joints_at_limit": limits,
        "missing_m": short[0],
        "missing_rad": short[1],
        "least_singular_value": least,
        "near_singularity": least < SINGULAR,
    }
    if limits:
        cause, text = LIMIT, f"{', '.join(limits)} at the limit"
    elif next(iter(ik.solutions(pose, before)), None) is None:
        cause, text = REACH, "out of reach"
        evidence["reach_m"] = ik.chain_data.chain.reach
    elif least < SINGULAR:
        cause, text = SINGULARITY, f"singular (smallest singular value {least:.3f})"
    else:
        cause, text = BRANCH, "another joint solution reaches the pose, but not from here"
    missing = f"{short[0] * 1000:.1f} mm, {np.rad2deg(short[1]):.1f} deg short"
    return StopReason(cause, f"{text} ({missing})", ErrorCode.NO_IK_SOLUTION, evidence)


ZONE, ZONE_SHARE = 0.35, 0.15  # [rad or m], and share of the range: a joint so near a limit moves away


@dataclass(frozen=True, eq=False)
class FollowedLine:
    """Result of following a Cartesian line: the joint positions (n,) at each step up to the point where the
    robot must stop, and the reason for the stop.

    The stop is None if the line is complete.
    """

    path: list[F64]
    stop: Stop | None


def _near(checker: KernelChecker, q: F64) -> list[Contact]:
    """List the pairs of bodies that touch, or are closer than the padding, when a robot that follows a
    Cartesian line is at positions q (n,).

    The list has only the nearest pair if just the kernel checker finds one.
    """
    if found := checker.exact.contacts(q):
        return found
    nearest = checker.exact.nearest(q)
    return [] if nearest is None else [nearest]


class RestingStartRule:
    """Collision rule for following a line whose start is in resting contact; the rule applies until the arm
    has left this contact.
    """

    def __init__(self, checker: KernelChecker, start: F64):
        near = resting_pairs(checker.exact, start)
        self._leaving = SeparationChecker(checker.exact, start, near)
        self._others = KernelChecker(with_allowed_contacts(checker.scene, near), checker.joint_names)
        self._others.relax_margins(start)

    def forbidden_contacts(self, q: F64) -> list[Contact] | None:
        """Return the contacts at joint positions q (n,) that are forbidden while following a line from a
        start in resting contact. Return None if q is allowed.
        """
        if (contact := self._leaving.forbidden_contact(q)) is not None:
            return [contact]
        return None if self._others.is_free(q) else _near(self._others, q)


class LineFollower:
    """Solver that follows Cartesian lines step by step by inverse kinematics of one group. All other joints
    keep their positions in `rest` (dof,).

    Args:
        bounds: (n, 2) lower and upper limits that the group's joints keep.
        resting: rules for leaving the contact if the start is in resting contact.
    """

    def __init__(
        self, request: CartesianRequest, ik: IKSolver, checker: KernelChecker | None,
        manifold: ConstraintManifold | None, rest: F64, bounds: F64, cancel: threading.Event,
        resting: RestingStartRule | None = None,
    ):  # fmt: skip
        self.cancel, self.resting = cancel, resting
        self.request, self.ik, self.checker, self.manifold = request, ik, checker, manifold
        self.rest, self.bounds = rest, np.ascontiguousarray(bounds)
        slides = np.array([ik.model.joint(name).type == "prismatic" for name in ik.joint_names])
        most = np.where(slides, request.prismatic_jump_threshold, request.jump_threshold)
        self.most = np.where(most > 0, most, np.inf)  # 0 switches the test off, as in MoveIt
        self.slides = slides
        span = bounds[:, 1] - bounds[:, 0]
        self.zone = np.where(np.isfinite(span), np.minimum(ZONE, ZONE_SHARE * span), 0.0)

    def follow(self, poses: list[SE3], start: F64) -> FollowedLine:
        """Follow the tip poses of a Cartesian line from joint positions (n,), and return the attempt that
        gets farthest.
        """
        best = None
        for wish in self._wishes(poses, start):
            tried = self._walk(poses, start, wish)
            if best is None or len(tried.path) > len(best.path):
                best = tried
            if best.stop is None:
                break
        assert best is not None
        return best

    def _wishes(self, poses: list[SE3], start: F64) -> Iterator[JointPreference | None]:
        if len(start) <= TASK:
            yield None
            return
        yield self._from_limits
        yield None
        way = plan_redundancy(
            self.ik, poses, start, self.rest, self.bounds, self.zone, lambda q: self._refused(q) is None
        )
        if way is not None:
            yield lambda q, k: way[k] - q

    def _from_limits(self, q: F64, k: int) -> F64:
        low, high = self.bounds[:, 0] + self.zone - q, q - self.bounds[:, 1] + self.zone
        return GAIN * (np.maximum(low, 0.0) - np.maximum(high, 0.0))

    def _walk(self, poses: list[SE3], start: F64, wish: JointPreference | None) -> FollowedLine:
        ik, q = self.ik, self._full(start)
        path: list[F64] = []
        last = start
        for k, pose in enumerate(poses):
            if self.cancel.is_set():
                break
            before = q.copy()
            step = None if wish is None else wish(last, k)
            if step is not None:
                step *= min(1.0, FASTEST / max(float(np.abs(step).max()), 1e-12))
            meters, radians, ok = ik.descend(q, pose, wish=step, bounds=self.bounds)
            now = q[ik.columns].copy()
            if not ok:
                at = (now - self.bounds[:, 0] < 1e-3) | (self.bounds[:, 1] - now < 1e-3)
                limits = [name for name, yes in zip(ik.joint_names, at, strict=True) if yes]
                short = (meters, radians)
                return FollowedLine(path, Stop(partial(ik_stop, ik, pose, before, q, short, limits)))
            moved = np.abs(now - last)
            worst = int((moved / self.most).argmax())
            if moved[worst] > self.most[worst]:
                jump = (ik.joint_names[worst], float(moved[worst]), float(self.most[worst]))
                kind = (SLIDING, "m") if self.slides[worst] else (TURNING, "rad")
                return FollowedLine(path, Stop(partial(jump_stop, *jump, *kind)))
            if (stop := self._refused(now)) is not None:
                return FollowedLine(path, stop)
            path.append(now)
            last = now
        return FollowedLine(path, None)

    def _refused(self, q: F64) -> Stop | None:
        """Return the reason why the arm must not move to positions q (n,) when it follows a Cartesian line,
        or None if q is allowed.
        """
        checker, manifold = self.checker, self.manifold
        if checker is not None and not checker.is_free(q):
            if self.resting is None:
                return Stop(lambda: collision_stop(_near(checker, q)))
            if (found := self.resting.forbidden_contacts(q)) is not None:
                return Stop(lambda: collision_stop(found))
        if manifold is not None and at_violation(manifold, q):
            return Stop(lambda: constraint_stop(manifold, q))
        return None

    def _full(self, q: F64) -> F64:
        full = self.rest.copy()
        full[self.ik.columns] = q
        return full


def relative_jump(
    path: F64, names: tuple[str, ...], slides: NDArray[np.bool_], factor: float
) -> tuple[int, Stop] | None:
    """Find the first step of a followed Cartesian line in which the joints move more than `factor` times as
    far as in an average step (as MoveIt does).

    The length of a step is the sum of all joints' motions.

    Args:
        path: joint positions (k, n).
        slides: (n,) which joints are prismatic.
    """
    moved = np.abs(np.diff(path, axis=0))
    steps = moved.sum(axis=1)
    if factor <= 0 or not len(steps) or not np.any(steps > factor * steps.mean()):
        return None
    k = int(np.argmax(steps > factor * steps.mean()))
    joint = int(np.argmax(moved[k]))
    unit = "m" if slides[joint] else "rad"
    return k, Stop(partial(jump_stop, names[joint], float(moved[k, joint]), factor, RELATIVE, unit))
