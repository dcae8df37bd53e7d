"""From one motion into the next without a stop: MoveIt's transition window.

Inside a sphere around the corner both motions run at once, and the pose goes over from the one to the other
by a quintic of the time (trajectory_blender_transition_window.cpp). Whichever is longer inside the sphere
gives the window its length; the other one's end waits in the corner.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armcell.core import ErrorCode, JointTrajectory, Outcome
from armcell.kinematics import IKSolver
from armcell.planning.industrial.curves import JointSpline
from armcell.planning.industrial.profile import SAMPLE_TIME
from armcell.planning.placed import Placed

Array = NDArray[np.float64]

GRID = 0.002  # [s] between inverse kinematics solutions
BISECTIONS = 40


@dataclass(frozen=True, eq=False)
class Blend:
    """What replaces the end of one motion and the begin of the next.

    Attributes:
        leaves: time in the first motion at which it begins [s]. joins: time in the second where it ends.
        curve: the joints over the window's time [s].
    """

    leaves: float
    joins: float
    curve: JointSpline
    trajectory: JointTrajectory


def blended(
    first: JointTrajectory, second: JointTrajectory, radius: float, placed: Placed, ik: IKSolver
) -> Blend | Outcome:
    """The way from `first` to `second` inside a sphere of `radius` [m] around the point where they meet."""
    corner = placed.pose(first.positions[-1]).translation

    def outside(trajectory: JointTrajectory, t: float) -> bool:
        at = placed.pose(trajectory.sample(t)[0]).translation
        return bool(np.linalg.norm(at - corner) > radius)

    entering = [t for t in first.times if outside(first, t)]
    leaving = [t for t in second.times if outside(second, t)]
    if not entering or not leaving:
        which = "first" if not entering else "second"
        text = f"the blend radius of {radius * 1000:.0f} mm is too large: the {which} motion is all inside it"
        return Outcome(ErrorCode.INVALID_MOTION_PLAN, text, {"radius": radius})
    leaves = _border(lambda t: outside(first, t), entering[-1], first.duration)
    joins = _border(lambda t: outside(second, t), leaving[0], 0.0)
    return _window(first, second, leaves, joins, placed, ik)


def _border(outside, far: float, near: float) -> float:
    """The time between one outside and one inside at which the sphere is crossed."""
    for _ in range(BISECTIONS):
        middle = (far + near) / 2
        far, near = (middle, near) if outside(middle) else (far, middle)
    return far


def _window(
    first: JointTrajectory, second: JointTrajectory, leaves: float, joins: float, placed: Placed, ik: IKSolver
) -> Blend | Outcome:
    duration = max(first.duration - leaves, joins)
    count = max(int(np.ceil(duration / GRID)), 8)
    moments = np.linspace(0.0, duration, count + 1)
    points = []
    for t in moments:
        qa, qb = first.sample(leaves + t)[0], second.sample(t - (duration - joins))[0]
        s = t / duration
        share = s**3 * (10.0 + s * (6.0 * s - 15.0))
        pose = placed.pose(qa).interpolate(placed.pose(qb), share)
        q = placed.full(qa + share * (qb - qa))  # near the solution, and on it at both ends
        metres, radians, ok = ik.descend(q, placed.link_target(pose))
        if not ok:
            text = f"out of reach or singular ({metres * 1000:.1f} mm, {np.rad2deg(radians):.1f} deg short)"
            return Outcome(ErrorCode.NO_IK_SOLUTION, text, {"joints_at_limit": ik.at_limit(q[ik.columns])})
        points.append(q[ik.columns].copy())
    (qa, va, aa), (qb, vb, ab) = first.sample(leaves), second.sample(joins)
    points[0], points[-1] = qa, qb
    curve = JointSpline(moments, np.array(points), np.array([va, vb]))
    times = np.linspace(0.0, duration, max(int(np.ceil(duration / SAMPLE_TIME)), 4) + 1)
    q, v, a = curve.at(times)
    a[0], a[-1] = aa, ab  # the window's weights begin and end with no speed and no acceleration
    return Blend(leaves, joins, curve, JointTrajectory(first.joint_names, times, q, v, a))
