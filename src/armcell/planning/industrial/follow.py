"""A way of the tip as a curve of the joints: inverse kinematics step by step, without a jump."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from armcell.core import ErrorCode, Outcome
from armcell.kinematics import IKSettings, IKSolver, ik_solver
from armcell.planning.industrial.curves import JointSpline
from armcell.planning.industrial.paths import TipPath
from armcell.planning.placed import Placed

Array = NDArray[np.float64]

EXACT = IKSettings(position_tolerance=1e-9, rotation_tolerance=1e-9)
"""Far below what is wanted of the tip: what a step is off goes into accelerations by its square."""

STEP, TURN = 0.005, 0.05  # [m], [rad] of the way between two solutions
ARC_STEP = 0.05  # [rad] of an arc's sweep between two
OFF = 1e-6  # [m], [rad] the tip may be off its way between two; else the steps are halved
HALVINGS = 5
GOAL_MISSED = 0.02  # [rad or m] beside a goal given as joint positions from where it is aimed at anew
AT_GOAL = 1e-6  # [rad or m] is at it
AIMS = 4


def solver_for(placed: Placed, group: str) -> IKSolver:
    return ik_solver(placed.scene.model, group, placed.link, EXACT)


def follow(
    path: TipPath,
    placed: Placed,
    ik: IKSolver,
    start: Array,
    goal: Array | None = None,
    stopped: Callable[[], Outcome | None] = lambda: None,
) -> JointSpline | Outcome:
    """Joint positions (n,) along a way of the tip, as a curve over s in 0..1.

    Args:
        start: (n,), where the tip is at the beginning of the way.
        goal: (n,) to end at, if that is asked for: a redundant arm is led there on its way.
        stopped: what to answer if the time is over or the request cancelled.
    Returns:
        The curve, or the code, message and evidence (`fraction`) of where it stops.
    """
    count = max(int(np.ceil(path.length / STEP)), int(np.ceil(path.angle / TURN)), 4)
    count = max(count, int(np.ceil(getattr(path, "sweep", 0.0) / ARC_STEP)))
    off, at = np.inf, 0.0
    for _ in range(HALVINGS):
        if (answer := stopped()) is not None:
            return answer
        points = _led(path, placed, ik, start, goal, count)
        if isinstance(points, Outcome):
            return points
        curve = JointSpline(np.linspace(0.0, 1.0, count + 1), points)
        off, at = _largest_error(path, placed, curve, count)
        if off <= OFF:
            return curve
        count *= 2
    text = f"near {at:.0%} of the way the joints would have to jump (the tip would leave it by {off:.2g} m)"
    return Outcome(ErrorCode.PLANNING_FAILED, text, {"fraction": at})


def _led(
    path: TipPath, placed: Placed, ik: IKSolver, start: Array, goal: Array | None, count: int
) -> Array | Outcome:
    """Solutions (count + 1, n) that end at the goal (n,), where there is one."""
    points = _solutions(path, placed, ik, start, goal, count)
    if goal is None:
        return points
    aim = goal
    for _ in range(AIMS):
        if isinstance(points, Outcome) or np.max(np.abs(points[-1] - goal)) <= AT_GOAL:
            return points
        if np.max(np.abs(points[-1] - goal)) > GOAL_MISSED:
            break
        aim = aim + goal - points[-1]
        points = _solutions(path, placed, ik, start, aim, count)
    if isinstance(points, Outcome):
        return points
    k = int(np.argmax(np.abs(points[-1] - goal)))
    text = (
        "on this way the arm comes to the goal's pose with other joint positions: "
        f"{ik.joint_names[k]} at {points[-1][k]:.3f} instead of {goal[k]:.3f}"
    )
    return Outcome(ErrorCode.PLANNING_FAILED, text, {"fraction": 1.0, "joint": ik.joint_names[k]})


def _solutions(
    path: TipPath, placed: Placed, ik: IKSolver, start: Array, goal: Array | None, count: int
) -> Array | Outcome:
    """(count + 1, n), each found from the one before."""
    q = placed.full(start)
    points = [start]
    for k in range(1, count + 1):
        s = k / count
        if goal is not None:
            q[ik.columns] += _sideways(ik, q, start + s * (goal - start) - points[-1])
        metres, radians, ok = ik.descend(q, placed.link_target(path.pose(s)))
        if not ok:
            return _stops(path, ik, points[-1], s, metres, radians)
        points.append(q[ik.columns].copy())
    return np.array(points)


def _sideways(ik: IKSolver, q: Array, wish: Array) -> Array:
    """The part of a joint step (n,) that leaves the tip where it is (none for an arm of six joints)."""
    J = ik.tree.jacobian(q, ik.tip_link, ik.joint_names)
    return wish - np.linalg.pinv(J, rcond=1e-4) @ (J @ wish)


def _stops(path: TipPath, ik: IKSolver, last: Array, s: float, metres: float, radians: float) -> Outcome:
    limits = ik.at_limit(last)
    why = f"{', '.join(limits)} at the limit" if limits else "out of reach or singular"
    at = ", ".join(f"{v:.3f}" for v in path.pose(s).translation)
    text = (
        f"stops at {s:.0%} of the way, before ({at}): {why} "
        f"({metres * 1000:.1f} mm, {np.rad2deg(radians):.1f} deg short)"
    )
    return Outcome(ErrorCode.NO_IK_SOLUTION, text, {"fraction": s, "joints_at_limit": limits})


def _largest_error(path: TipPath, placed: Placed, curve: JointSpline, count: int) -> tuple[float, float]:
    """How far the tip is off its way half-way between solutions [m or rad], and where that is most."""
    middles = (np.arange(count) + 0.5) / count
    errors = [
        max(placed.pose(q).distance_to(path.pose(s)))
        for s, q in zip(middles, curve.at(middles)[0], strict=True)
    ]
    worst = int(np.argmax(errors))
    return errors[worst], float(middles[worst])
