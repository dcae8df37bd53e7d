"""Visibility constraints: whether a sensor sees its target, and how far the view is from the limits."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from armcell.collision import links_in_hull, view_cone
from armcell.core import SE3, InputError, UnknownNameError, VisibilityConstraint
from armcell.scene import PlanningScene

Array = NDArray[np.float64]

AXES = {"x": 0, "z": 2}
EDGE_ON = 1e-6  # [m] distance from the disc's plane at which the sensor does not see the disc


def visibility(scene: PlanningScene, c: VisibilityConstraint) -> tuple[Array, Array, str]:
    """Evaluate a visibility constraint at the state of a scene: how the sensor sees its target, and how far
    the view exceeds the limits.

    The rule is MoveIt's (kinematic_constraints::VisibilityConstraint::decide).

    Returns:
        error (3,): view angle, range angle [rad], depth [m] of the deepest link in the cone; excess (3,):
        the part beyond the limits; and a description of the violations.
    """
    sensor, target, view, range_ = view_of(scene, c)
    violations_found, excess = [], np.zeros(3)
    for k, (angle, most, what) in enumerate(
        ((view, c.max_view_angle, "the target's axis"), (range_, c.max_range_angle, "the target"))
    ):
        # Beyond 90 deg the sensor looks at the wrong side, whatever the limit.
        if most is not None and angle > min(most, np.pi / 2):
            excess[k] = angle - min(most, np.pi / 2)
            degrees, over = np.rad2deg(angle), np.rad2deg(excess[k])
            violations_found.append(f"{c.sensor} looks {degrees:.1f} deg past {what}, {over:.1f} too far")
    depth = 0.0
    if abs(target.inverse().apply(sensor.translation)[2]) <= EDGE_ON:
        excess[0] = max(excess[0], np.pi / 2)
        violations_found.append(f"{c.sensor} sees the target from its edge")
    else:
        corners = view_cone(sensor.translation, target, c.target_radius, c.cone_sides)
        within = links_in_hull(scene, corners, own_links(scene, c))
        if within:
            depth = max(within.values())
            excess[2] = max(depth, 2 * EDGE_ON)  # a link that touches the cone counts as inside
            violations_found.append(
                f"{', '.join(sorted(within))} in the view of {c.sensor}, {depth * 1000:.1f} mm deep"
            )
    return np.array([view, range_, depth]), excess, "; ".join(violations_found)


def view_of(scene: PlanningScene, c: VisibilityConstraint) -> tuple[SE3, SE3, float, float]:
    """Return the quantities of a visibility constraint at the state of a scene: the world poses of the
    sensor and the target, the view angle and the range angle [rad].
    """
    sensor = scene.frame_pose(c.sensor) @ c.T_link_sensor
    target = scene.frame_pose(c.frame) @ c.T_frame_target
    looks = sensor.rotation.matrix[:, AXES[c.view_axis]]
    way = target.translation - sensor.translation
    return sensor, target, _angle(looks, -target.rotation.matrix[:, 2]), _angle(looks, way)


def own_links(scene: PlanningScene, c: VisibilityConstraint) -> frozenset[str]:
    """Return the links that carry the sensor and the target of a visibility constraint. These links may be
    inside the view cone.
    """
    return frozenset((scene.anchor(c.sensor)[0], scene.anchor(c.frame)[0]))


def check_visibility(scene: PlanningScene, c: VisibilityConstraint) -> None:
    """Check the frames and numbers of a visibility constraint, and raise an error if one of them is
    invalid.

    Raises:
        UnknownNameError: no such frame or axis.
        InputError: an impossible radius, angle or number of sides.
    """
    scene.frame_pose(c.sensor)
    scene.frame_pose(c.frame)
    if c.view_axis not in AXES:
        raise UnknownNameError("view axis", c.view_axis, AXES)
    if not (np.isfinite(c.target_radius) and c.target_radius > 0):
        raise InputError(f"a target's radius is {c.target_radius:g} m, it must be positive")
    if c.cone_sides != int(c.cone_sides) or c.cone_sides < 3:
        raise InputError(f"a cone of {c.cone_sides} sides", hint="give at least 3")
    for what, angle in (("view", c.max_view_angle), ("range", c.max_range_angle)):
        if angle is not None and not 0 < angle <= np.pi:
            raise InputError(f"max_{what}_angle is {angle:g} rad", hint="give an angle in (0, pi], or None")


def _angle(a: Array, b: Array) -> float:
    """Compute the angle [rad] between two directions, such as the view angle of a visibility constraint. The
    result is accurate even for small angles.
    """
    (u, v, w), (x, y, z) = a.tolist(), b.tolist()  # plain floats: a tenth of the time of np.cross
    return math.atan2(math.hypot(v * z - w * y, w * x - u * z, u * y - v * x), u * x + v * y + w * z)
