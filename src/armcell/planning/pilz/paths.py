"""Tip paths (line, arc), joint curves, inverse kinematics along a tip path, and checks of the motion."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from itertools import pairwise
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import SE3, SO3, Contact, ErrorCode, JointTrajectory, Outcome, PlanRequest
from armcell.kinematics import IKSettings, IKSolver, ik_solver
from armcell.model import RobotModel
from armcell.planning.moved_frame import MovedFrame
from armcell.timing.moving_average import peaks

Array = NDArray[np.float64]

COLLINEAR = 1e-5  # [m^2] cross product below which three points span no plane (MoveIt's MAX_COLINEAR_NORM)

RADIUS_DIFFERENCE = 1e-2  # [m] allowed between both ends' distances from the center (MAX_RADIUS_DIFF)


class TipPath(Protocol):
    """Interface (`typing.Protocol`) for tip paths of LIN and CIRC motions: a path returns the tip pose at the
    path parameter s in 0..1.

    Position and orientation change evenly with s.
    """

    start: SE3
    goal: SE3

    @property
    def length(self) -> float: ...  # [m]

    @property
    def angle(self) -> float: ...  # [rad]

    def pose(self, s: float) -> SE3: ...


class Line:
    """Straight path of the tip in a LIN motion between two poses."""

    def __init__(self, start: SE3, goal: SE3):
        self.start, self.goal = start, goal

    @cached_property
    def turn(self) -> Array:
        """Total rotation along the tip path of a LIN motion,
        as a rotation vector (3,) [rad] in the frame of the start pose.
        """
        return (self.start.rotation.inverse() @ self.goal.rotation).log()

    @property
    def length(self) -> float:
        return float(np.linalg.norm(self.goal.translation - self.start.translation))

    @property
    def angle(self) -> float:
        return float(np.linalg.norm(self.turn))

    def position(self, s: float) -> Array:
        return (1 - s) * self.start.translation + s * self.goal.translation

    def pose(self, s: float) -> SE3:
        return SE3(self.start.rotation @ SO3.exp(s * self.turn), self.position(s))


class Arc(Line):
    """Circular path of the tip in a CIRC motion between two poses.

    Args:
        axis: (3,) unit vector; the arc turns about it by `sweep` [rad], right-handed.
    """

    def __init__(self, start: SE3, goal: SE3, center: Array, axis: Array, sweep: float):
        super().__init__(start, goal)
        self.center, self.axis, self.sweep = center, axis, sweep

    @property
    def radius(self) -> float:
        """Radius [m] of the arc in a CIRC motion."""
        return float(np.linalg.norm(self.start.translation - self.center))

    @property
    def length(self) -> float:
        return self.radius * self.sweep

    def position(self, s: float) -> Array:
        turned = SO3.exp(s * self.sweep * self.axis).matrix
        return self.center + turned @ (self.start.translation - self.center)


def arc_through(start: SE3, goal: SE3, interim: Array) -> Arc | Outcome:
    """Compute the arc of a CIRC motion from start to goal through an interim point (3,) [m]."""
    a, b = interim - start.translation, goal.translation - start.translation
    normal = np.cross(a, b)
    size = float(np.linalg.norm(normal))
    if size < COLLINEAR:
        return _no_arc(
            "start, interim point and goal lie on one line (or two of them coincide)",
            "move the interim point aside, or use LIN",
        )
    # Circumscribed circle: https://en.wikipedia.org/wiki/Circumcircle#Higher_dimensions
    center = start.translation + np.cross((a @ a) * b - (b @ b) * a, normal) / (2 * size**2)
    axis = normal / size  # around this axis the order is start, interim, goal
    u, v = start.translation - center, goal.translation - center
    sweep = float(np.arctan2(axis @ np.cross(u, v), u @ v)) % (2 * np.pi)
    return Arc(start, goal, center, axis, sweep)


def arc_around(start: SE3, goal: SE3, center: Array) -> Arc | Outcome:
    """Compute the shorter arc of a CIRC motion from start to goal around a center (3,) [m].

    A center that is not exactly equidistant from start and goal is moved until it is: the arc keeps its
    radius and ends in the goal.
    """
    u, v = start.translation - center, goal.translation - center
    near, far = float(np.linalg.norm(u)), float(np.linalg.norm(v))
    if abs(near - far) > RADIUS_DIFFERENCE:
        text = (
            f"the center is {near * 1000:.1f} mm from the start and {far * 1000:.1f} mm from the goal, "
            f"they may differ by {RADIUS_DIFFERENCE * 1000:.0f} mm"
        )
        return _no_arc(text, "give a center that is as far from both, or an interim point")
    chord = goal.translation - start.translation
    length = float(np.linalg.norm(chord))
    if length > 1e-9:
        middle = (start.translation + goal.translation) / 2
        center = center - ((center - middle) @ chord) / length**2 * chord
        u, v = start.translation - center, goal.translation - center
    normal = np.cross(u, v)
    size = float(np.linalg.norm(normal))
    if size < COLLINEAR:
        return _no_arc(
            "start, center and goal lie on one line (or two of them coincide), so there is more than one arc",
            "give an interim point instead of the center",
        )
    return Arc(start, goal, center, normal / size, float(np.arctan2(size, u @ v)))


def _no_arc(why: str, hint: str) -> Outcome:
    return Outcome(ErrorCode.INVALID_MOTION_PLAN, f"CIRC: {why} ({hint})")


class Curve(Protocol):
    """Protocol for joint-space curves that follow a Pilz path. A curve is twice continuously differentiable
    in the path parameter s.
    """

    def at(self, s: Array) -> tuple[Array, Array, Array]:
        """Compute the joint positions on a Pilz path at path parameters s (m,) in 0..1, and their first and
        second derivatives with respect to s, each (m, n).
        """
        ...

    def polyline(self, sagitta: float) -> tuple[Array, Array]:
        """Approximate the joint-space curve of a Pilz path by straight chords between points (k, n) on the
        curve.

        Return the points and the largest deviation (n,) of the curve from their chords.
        """
        ...


class JointLine:
    """Straight line in joint space between two positions, the curve of a PTP motion."""

    def __init__(self, start: Array, goal: Array):
        self.start, self.step = start, goal - start

    def at(self, s: Array) -> tuple[Array, Array, Array]:
        first = np.tile(self.step, (len(s), 1))
        return self.start + s[:, None] * self.step, first, np.zeros_like(first)

    def polyline(self, sagitta: float) -> tuple[Array, Array]:
        return np.array([self.start, self.start + self.step]), np.zeros(len(self.start))


class JointSpline:
    """Joint-space curve that follows a LIN or CIRC path: a cubic spline through joint positions (k, n) at
    path parameters x (k,) in 0..1.

    Args:
        ends: first derivatives (2, n) at both ends, if specified.
    """

    def __init__(self, x: Array, points: Array, ends: Array | None = None):
        from scipy.interpolate import CubicSpline  # takes a quarter of a second to import

        bc: Any = "not-a-knot" if ends is None else ((1, ends[0]), (1, ends[1]))
        self.x, self.spline = x, CubicSpline(x, points, bc_type=bc)

    def at(self, s: Array) -> tuple[Array, Array, Array]:
        return self.spline(s), self.spline(s, 1), self.spline(s, 2)

    def polyline(self, sagitta: float) -> tuple[Array, Array]:
        # Second derivatives are linear between knots, so they are largest at knots; a chord over h deviates
        # by at most h^2 / 8 times the second derivative.
        bend = np.abs(self.spline(self.x, 2)).max(axis=0)
        span = self.x[-1] - self.x[0]
        count = max(int(np.ceil(span * np.sqrt(bend.max() / 8 / sagitta))), 1)
        return self.spline(np.linspace(self.x[0], self.x[-1], count + 1)), bend * (span / count) ** 2 / 8


EXACT = IKSettings(position_tolerance=1e-9, rotation_tolerance=1e-9)

"""Far below the tip's accuracy: position errors enter accelerations divided by the squared step."""

STEP, TURN = 0.005, 0.05  # [m], [rad] of the path between two solutions

ARC_STEP = 0.05  # [rad] of an arc's sweep between two solutions

OFF = 1e-6  # [m], [rad] largest deviation between solutions; otherwise the steps are halved

HALVINGS = 5

GOAL_MISSED = 0.02  # [rad or m] largest miss of a joint goal that further attempts can correct

AT_GOAL = 1e-6  # [rad or m] joint goal reached

AIMS = 4


def solver_for(moved_frame: MovedFrame, group: str) -> IKSolver:
    """Return an inverse kinematics solver with tight tolerances for the frame that follows a LIN or CIRC
    path.
    """
    return ik_solver(moved_frame.scene.model, group, moved_frame.link, EXACT)


def follow_path(
    path: TipPath,
    moved_frame: MovedFrame,
    ik: IKSolver,
    start: Array,
    goal: Array | None = None,
    stopped: Callable[[], Outcome | None] = lambda: None,
) -> JointSpline | Outcome:
    """Solve inverse kinematics along a LIN or CIRC path, and return a joint-space curve that follows the path
    over s in 0..1.

    Args:
        start: positions (n,) at the beginning of the path.
        goal: positions (n,) for the path's end, if specified; a redundant arm moves to them along the path.
        stopped: returns the outcome if the time is over or the request is canceled.
    Returns:
        The curve, or the code, message and evidence (`fraction`) of the stop.
    """
    count = max(int(np.ceil(path.length / STEP)), int(np.ceil(path.angle / TURN)), 4)
    count = max(count, int(np.ceil(getattr(path, "sweep", 0.0) / ARC_STEP)))
    off, at = np.inf, 0.0
    for _ in range(HALVINGS):
        if (answer := stopped()) is not None:
            return answer
        points = _led(path, moved_frame, ik, start, goal, count)
        if isinstance(points, Outcome):
            return points
        curve = JointSpline(np.linspace(0.0, 1.0, count + 1), points)
        off, at = _largest_error(path, moved_frame, curve, count)
        if off <= OFF:
            return curve
        count *= 2
    text = f"near {at:.0%} of the path the joints would have to jump (the tip would leave it by {off:.2g} m)"
    return Outcome(ErrorCode.PLANNING_FAILED, text, {"fraction": at})


def _led(
    path: TipPath, moved_frame: MovedFrame, ik: IKSolver, start: Array, goal: Array | None, count: int
) -> Array | Outcome:
    """Compute IK solutions (count + 1, n) along a LIN or CIRC path. If goal positions (n,) are given, the
    solutions end there.
    """
    points = _solutions(path, moved_frame, ik, start, goal, count)
    if goal is None:
        return points
    aim = goal
    for _ in range(AIMS):
        if isinstance(points, Outcome) or np.max(np.abs(points[-1] - goal)) <= AT_GOAL:
            return points
        if np.max(np.abs(points[-1] - goal)) > GOAL_MISSED:
            break
        aim = aim + goal - points[-1]
        points = _solutions(path, moved_frame, ik, start, aim, count)
    if isinstance(points, Outcome):
        return points
    k = int(np.argmax(np.abs(points[-1] - goal)))
    text = (
        "on this path the arm reaches the goal's pose with other joint positions: "
        f"{ik.joint_names[k]} at {points[-1][k]:.3f} instead of {goal[k]:.3f}"
    )
    return Outcome(ErrorCode.PLANNING_FAILED, text, {"fraction": 1.0, "joint": ik.joint_names[k]})


def _solutions(
    path: TipPath, moved_frame: MovedFrame, ik: IKSolver, start: Array, goal: Array | None, count: int
) -> Array | Outcome:
    """Solve inverse kinematics at every pose of a LIN or CIRC path (count + 1, n); each solution starts from
    the previous one.
    """
    q = moved_frame.full(start)
    points = [start]
    for k in range(1, count + 1):
        s = k / count
        if goal is not None:
            q[ik.columns] += _sideways(ik, q, start + s * (goal - start) - points[-1])
        meters, radians, ok = ik.descend(q, moved_frame.link_target(path.pose(s)))
        if not ok:
            return _stops(path, ik, points[-1], s, meters, radians)
        points.append(q[ik.columns].copy())
    return np.array(points)


def _sideways(ik: IKSolver, q: Array, wish: Array) -> Array:
    """Project a joint step (n,) onto the null space of the Jacobian, so that the tip stays on its LIN or CIRC
    path. For an arm with 6 joints, the result is zero except at singularities.
    """
    J = ik.tree.jacobian(q, ik.tip_link, ik.joint_names)
    return wish - np.linalg.pinv(J, rcond=1e-4) @ (J @ wish)


def _stops(path: TipPath, ik: IKSolver, last: Array, s: float, meters: float, radians: float) -> Outcome:
    limits = ik.at_limit(last)
    why = f"{', '.join(limits)} at the limit" if limits else "out of reach or singular"
    at = ", ".join(f"{v:.3f}" for v in path.pose(s).translation)
    text = (
        f"stops at {s:.0%} of the path, before ({at}): {why} "
        f"({meters * 1000:.1f} mm, {np.rad2deg(radians):.1f} deg short)"
    )
    return Outcome(ErrorCode.NO_IK_SOLUTION, text, {"fraction": s, "joints_at_limit": limits})


def _largest_error(
    path: TipPath, moved_frame: MovedFrame, curve: JointSpline, count: int
) -> tuple[float, float]:
    """Return the largest deviation [m or rad] of the tip from a LIN or CIRC path, measured half-way between
    IK solutions.
    """
    middles = (np.arange(count) + 0.5) / count
    errors = [
        max(moved_frame.pose(q).distance_to(path.pose(s)))
        for s, q in zip(middles, curve.at(middles)[0], strict=True)
    ]
    worst = int(np.argmax(errors))
    return errors[worst], float(middles[worst])


ROUNDING = 1e-6

SPARE = 1.02  # safety factor of the suggested slowdown


def check_joint_limits(
    model: RobotModel, trajectory: JointTrajectory, request: PlanRequest | None, what: str = ""
) -> Outcome | None:
    """Check whether the motion along a PTP, LIN or CIRC path respects the joint limits. Return None if it
    does, else the worst joint and the slowdown that would help.

    The limits are the joints' own: the request's scalings apply to the tip, as in MoveIt.

    Args:
        request: request whose scalings define the motion; None if two scalings cannot describe the motion.
    """
    names = trajectory.joint_names
    velocity, acceleration = model.limits(names, "velocity"), model.limits(names, "acceleration")
    q, v, a = trajectory.positions, trajectory.velocities, trajectory.accelerations
    assert v is not None and a is not None
    peak_v, peak_a = peaks(trajectory.times, q, v, a, velocity, acceleration)
    if peak_v <= 1.0 + ROUNDING and peak_a <= 1.0 + ROUNDING:
        return None
    slower = max(peak_v, float(np.sqrt(peak_a)))
    by_velocity = peak_v >= np.sqrt(peak_a)
    ratios = np.abs(v) / velocity if by_velocity else np.abs(a) / acceleration
    row, joint = (int(i) for i in np.unravel_index(np.argmax(ratios), ratios.shape))
    kind, unit = ("velocity", "rad/s") if by_velocity else ("acceleration", "rad/s^2")
    if model.joint(names[joint]).type == "prismatic":
        unit = unit.replace("rad", "m")
    limit = float((velocity if by_velocity else acceleration)[joint])
    needed = limit * float(peak_v if by_velocity else peak_a)
    at = float(trajectory.times[row] / trajectory.duration)
    text = (
        f"{what}{names[joint]} would need a {kind} of {needed:.3g} {unit} at {at:.0%} of the time, "
        f"its limit is {limit:.3g}: it has to be {slower:.3g} times slower"
    )
    evidence = {"joint": names[joint], kind: needed, "limit": limit, "slower": slower, "fraction": at}
    if request is not None:
        v_scale = request.velocity_scaling / (slower * SPARE)
        a_scale = request.acceleration_scaling / (slower * SPARE) ** 2
        text += f" (velocity_scaling {v_scale:.3g} with acceleration_scaling {a_scale:.3g} would do)"
        evidence |= {"velocity_scaling": v_scale, "acceleration_scaling": a_scale}
    return Outcome(ErrorCode.PLANNING_FAILED, text, evidence)


SAGITTAS = (2e-4, 1e-5)

"""[rad or m] deviation of the proven chords from the motion; the second if the first is too coarse."""

BETWEEN_POINTS = 1e-7  # [rad or m] deviation of the interpolation between trajectory points from the curve

TOUCH_STEP = 0.005  # [rad or m] resolution of the first contact

PADDING_STEP = 0.03  # [rad] between padding checks


def prove_motion_free(
    checker: KernelChecker, curve: Curve, moved_frame: MovedFrame | None, what: str
) -> Array | Outcome:
    """Prove that the path of a PTP, LIN or CIRC motion is collision-free, and return its points (k, n). The
    proof ignores the padding, which is checked only at samples of the path.

    If the motion is not free, return the contact.
    """
    points = np.empty((0, 0))
    certificate = None
    for sagitta in SAGITTAS:
        points, slack = curve.polyline(sagitta)
        certificate = checker.certify(points, slack + BETWEEN_POINTS, evidence=sagitta == SAGITTAS[-1])
        if certificate.free:
            break
    assert certificate is not None
    if not certificate.free:
        at, q = _first_touching(checker, points, certificate.at)
        contacts = checker.exact.contacts(q, padded=False) or [c for c in [certificate.contact] if c]
        return _touches(what, at, q, contacts, moved_frame)
    for k, (a, b) in enumerate(pairwise(points)):
        if not checker.edge_is_free(a, b, PADDING_STEP):
            q, share = _first_padded(checker, a, b)
            return _touches(what, (k + share) / (len(points) - 1), q, checker.exact.contacts(q), moved_frame)
    return points


def _between(points: Array, at: float) -> Array:
    place = at * (len(points) - 1)
    k = min(int(place), len(points) - 2)
    return points[k] + (place - k) * (points[k + 1] - points[k])


def _first_touching(checker: KernelChecker, points: Array, at: float) -> tuple[float, Array]:
    """Find the first contact on the path of a PTP, LIN or CIRC motion, given a later point of the path at
    which there is a contact.

    The certification does not test a motion from its start to its end.
    """
    length = float(np.abs(np.diff(points, axis=0)).max(axis=1).sum())
    for share in np.linspace(0.0, at, max(int(np.ceil(length * at / TOUCH_STEP)), 1), endpoint=False):
        if checker.touches(q := _between(points, float(share))):
            return float(share), q
    return at, _between(points, at)


def _first_padded(checker: KernelChecker, a: Array, b: Array) -> tuple[Array, float]:
    count = max(int(np.ceil(np.max(np.abs(b - a)) / PADDING_STEP)), 1)
    for share in np.linspace(0.0, 1.0, count + 1):
        if not checker.is_free(a + share * (b - a)):
            return a + share * (b - a), float(share)
    return b, 1.0


def _touches(
    what: str, at: float, q: Array, contacts: list[Contact], moved_frame: MovedFrame | None
) -> Outcome:
    where = ""
    if moved_frame is not None:
        where = (
            f", {moved_frame.name} at ("
            + ", ".join(f"{v:.3f}" for v in moved_frame.pose(q).translation)
            + ")"
        )
    text = "; ".join(c.describe() for c in contacts[:3]) or "it cannot be proven free"
    evidence = {"contacts": contacts, "fraction": at, "positions": q}
    return Outcome(ErrorCode.INVALID_MOTION_PLAN, f"{what} at {at:.0%} of the path{where}: {text}", evidence)
