"""Two arms carry one object: the object's way is planned, and each arm follows it by a fixed grasp.

Both arms' inverse kinematics is solved along the way on one branch, so the relative pose of the hands is
that of the grasps at every instant; one time law moves the object from rest to rest between its waypoints.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import SE3, ErrorCode, InputError, JointPath, JointTrajectory, PlanResult
from armcell.kinematics import ik_solver, kinematic_tree
from armcell.scene import PlanningScene
from armcell.timing.chords import chords

Array = NDArray[np.float64]

STEP, TURN = 0.01, 0.02  # [m] and [rad] of the object between two solutions of the inverse kinematics
JUMP = 0.2  # [rad] more than that between two of them is another branch
KNOT = 0.02  # [s] between points of the trajectory
PEAK_SPEED = 1.875  # of the quintic from rest to rest, over its mean


@dataclass(frozen=True, eq=False)
class Carried:
    """An object in two hands: by group, the pose of the hand's tcp in the object's frame."""

    name: str
    grasps: Mapping[str, SE3]  # T_object_tcp
    tips: Mapping[str, str]  # by group, the tcp link


def plan_carry(
    scene: PlanningScene,
    both: str,
    carried: Carried,
    start: SE3,
    poses: Sequence[SE3],
    velocity_scaling: float = 0.3,
    acceleration_scaling: float = 0.2,
    max_speed: float = 0.25,
) -> PlanResult:
    """A motion of both arms that carries the object through poses, at rest in each.

    Args:
        scene: with the arms where the motion begins and the object attached to one of them, and allowed to
            touch the other's hand.
        both: the group of both arms' joints.
        start: T_world_object where the motion begins. poses: where it goes, straight and evenly turned.
        max_speed: of the object [m/s].
    Returns:
        SUCCESS with the trajectory, or where on the way an arm cannot follow or something touches.
    Raises:
        InputError: no pose, scalings outside (0, 1], a speed that is not positive.
    """
    began = time.monotonic()
    if not poses:
        raise InputError("a carried object needs a pose to go to")
    for what, value in (("velocity", velocity_scaling), ("acceleration", acceleration_scaling)):
        if not 0 < value <= 1:
            raise InputError(f"{what} scaling is {value:g}, it must be in (0, 1]")
    if not max_speed > 0:
        raise InputError(f"max_speed is {max_speed:g} m/s, it must be positive")
    names = scene.model.group(both).joint_names
    columns = scene.model.columns(names)
    checker = KernelChecker(scene, names)
    limits = [
        scene.model.limits(names, kind) * share
        for kind, share in (("velocity", velocity_scaling), ("acceleration", acceleration_scaling))
    ]
    q, rows, clock = scene.positions.copy(), [], 0.0
    times: list[Array] = []
    values: list[list[Array]] = [[], [], []]
    for k, (a, b) in enumerate(zip((start, *poses), poses, strict=False)):
        found = _followed(scene, carried, a, b, q)
        if isinstance(found, str):
            return _failed(f"on the way to pose {k + 1} of {len(poses)}: {found}", began)
        path = found[:, columns]
        rows.append(path)
        law = _timed(path, a, b, limits[0], limits[1], max_speed)
        exact = _along(scene, carried, a, b, law[1], q)
        if isinstance(exact, str):
            return _failed(f"on the way to pose {k + 1} of {len(poses)}: {exact}", began)
        for into, part in zip(values, _derivatives(law[0], exact[:, columns]), strict=True):
            into.append(part if not into else part[1:])
        times.append(law[0] if not times else law[0][1:] + clock)
        clock = float(times[-1][-1])
        q = exact[-1].copy()
    trajectory = JointTrajectory(names, np.concatenate(times), *(np.vstack(v) for v in values))
    _, points, room = chords((trajectory,), (0.0,), 0.0, trajectory.duration)
    proof = checker.certify(points, room)
    if not proof.free:
        what = "" if proof.contact is None else f": {proof.contact.describe()}"
        evidence = {"contacts": [proof.contact] if proof.contact else []}
        return _failed(f"the way is blocked at {100 * proof.at:.0f} %{what}", began, evidence)
    return PlanResult(
        ErrorCode.SUCCESS, path=JointPath(names, np.vstack(rows)), trajectory=trajectory, planner_id="carry",
        planning_time=time.monotonic() - began, clearance=lambda: checker.clearance(points),
    )  # fmt: skip


def _failed(text: str, began: float, evidence: dict | None = None) -> PlanResult:
    return PlanResult(
        ErrorCode.PLANNING_FAILED, text, evidence or {}, planner_id="carry",
        planning_time=time.monotonic() - began,
    )  # fmt: skip


def _followed(scene: PlanningScene, carried: Carried, a: SE3, b: SE3, q: Array) -> Array | str:
    """All joints (k, dof) along a straight way of the object, on one branch; or who cannot follow where."""
    metres, radians = a.distance_to(b)
    count = max(int(np.ceil(max(metres / STEP, radians / TURN))), 4)
    return _along(scene, carried, a, b, np.linspace(0, 1, count + 1), q)


def _along(scene: PlanningScene, carried: Carried, a: SE3, b: SE3, shares: Array, q: Array) -> Array | str:
    """The same at shares of the way, 0 to 1, of which two in a row are near each other."""
    rows, last = [], q.copy()
    solvers = {g: ik_solver(scene.model, g, carried.tips[g]) for g in carried.grasps}
    for share in shares:
        T = a.interpolate(b, float(share))
        new = last.copy()
        for group, ik in solvers.items():
            near = ik.nearest(T @ carried.grasps[group], last, among=8)
            if not near:
                return f"{group} does not reach {100 * share:.0f} % of it"
            if np.max(np.abs(near[0] - last[ik.columns])) > JUMP:
                return f"{group} would have to change its posture at {100 * share:.0f} %"
            new[ik.columns] = near[0]
        rows.append(new)
        last = new
    return np.array(rows)


def _timed(path: Array, a: SE3, b: SE3, velocity: Array, acceleration: Array, max_speed: float):
    """Times (m,) and shares (m,) of the way: a quintic as quick as joints' limits and the speed allow."""
    s = np.linspace(0, 1, len(path))
    spline = CubicSpline(s, path)
    first, second = spline(s, 1), spline(s, 2)
    rate, bend = _quintic(s_of := np.linspace(0, 1, 201))[1:]
    # On the unit clock: rate and bend over time; the path's derivatives at the same shares.
    at = _quintic(s_of)[0]
    d1 = np.column_stack([np.interp(at, s, c) for c in first.T])
    d2 = np.column_stack([np.interp(at, s, c) for c in second.T])
    speed = np.max(np.abs(d1 * rate[:, None]) / velocity)
    accel = np.max(np.abs(d2 * rate[:, None] ** 2 + d1 * bend[:, None]) / acceleration)
    metres, _ = a.distance_to(b)
    duration = max(speed, np.sqrt(accel), PEAK_SPEED * metres / max_speed, 0.1)
    count = max(int(np.ceil(duration / KNOT)), 5)
    times = np.linspace(0, duration, count + 1)
    return times, _quintic(times / duration)[0]


def _quintic(x: Array) -> tuple[Array, Array, Array]:
    """From 0 to 1 at rest at both ends: value, first and second derivative."""
    return (
        x**3 * (10 - 15 * x + 6 * x**2),
        30 * x**2 * (1 - x) ** 2,
        60 * x * (1 - x) * (1 - 2 * x),
    )


def _derivatives(times: Array, q: Array) -> tuple[Array, Array, Array]:
    """Positions with velocities and accelerations of the spline through them, at rest at both ends."""
    spline = CubicSpline(times, q, bc_type="clamped")
    v, a = spline(times, 1), spline(times, 2)
    v[0] = v[-1] = a[0] = a[-1] = 0.0
    return q, v, a


def relative_pose_error(
    scene: PlanningScene, carried: Carried, names: tuple[str, ...], q: Array
) -> tuple[float, float]:
    """How far two hands are off the relative pose of their grasps at positions q (n,): [m], [rad]."""
    tree, full = kinematic_tree(scene.model), scene.positions.copy()
    full[scene.model.columns(names)] = q
    first, second = carried.grasps
    hands = {g: tree.link_pose(full, carried.tips[g]) for g in (first, second)}
    wanted = carried.grasps[first].inv() @ carried.grasps[second]
    return wanted.distance_to(hands[first].inv() @ hands[second])
