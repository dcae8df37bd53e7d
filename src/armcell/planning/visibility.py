"""Whether a sensor sees its target: angles, and the robot's links in the cone between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armcell.collision import cone, links_within
from armcell.core import SE3, InputError, UnknownNameError, VisibilityConstraint
from armcell.scene import PlanningScene

Array = NDArray[np.float64]

AXES = {"x": 0, "z": 2}
EDGE_ON = 1e-6  # [m] from the disc's plane: nothing of the disc is seen


def visibility(scene: PlanningScene, c: VisibilityConstraint) -> tuple[Array, Array, str]:
    """How far the scene's state is from keeping to a visibility constraint.

    The rule is MoveIt's (kinematic_constraints::VisibilityConstraint::decide).

    Returns:
        error (3,): view angle, range angle [rad], depth of the deepest link in the cone [m]; excess (3,):
        what of it is too much; and what is wrong, in words.
    """
    sensor, target, view, range_ = view_of(scene, c)
    said, excess = [], np.zeros(3)
    for k, (angle, most, what) in enumerate(
        ((view, c.max_view_angle, "the target's axis"), (range_, c.max_range_angle, "the target"))
    ):
        # Beyond 90 deg it looks at the wrong side, whatever the limit.
        if most is not None and angle > min(most, np.pi / 2):
            excess[k] = angle - min(most, np.pi / 2)
            told, over = np.rad2deg(angle), np.rad2deg(excess[k])
            said.append(f"{c.sensor} looks {told:.1f} deg past {what}, {over:.1f} too far")
    depth = 0.0
    if abs(target.inv().apply(sensor.translation)[2]) <= EDGE_ON:
        excess[0] = max(excess[0], np.pi / 2)
        said.append(f"{c.sensor} sees the target from its edge")
    else:
        corners = cone(sensor.translation, target, c.target_radius, c.cone_sides)
        within = links_within(scene, corners, own_links(scene, c))
        if within:
            depth = max(within.values())
            excess[2] = max(depth, 2 * EDGE_ON)  # to touch the cone is to be in it
            said.append(f"{', '.join(sorted(within))} in the view of {c.sensor}, {depth * 1000:.1f} mm deep")
    return np.array([view, range_, depth]), excess, "; ".join(said)


def view_of(scene: PlanningScene, c: VisibilityConstraint) -> tuple[SE3, SE3, float, float]:
    """Where sensor and target are in the world, the view angle and the range angle [rad]."""
    sensor = scene.frame_pose(c.sensor) @ c.T_link_sensor
    target = scene.frame_pose(c.frame) @ c.T_frame_target
    looks = sensor.rotation.matrix[:, AXES[c.view_axis]]
    way = target.translation - sensor.translation
    return sensor, target, _angle(looks, -target.rotation.matrix[:, 2]), _angle(looks, way)


def own_links(scene: PlanningScene, c: VisibilityConstraint) -> frozenset[str]:
    """The links that carry sensor and target: they may be in the cone."""
    return frozenset((scene.anchor(c.sensor)[0], scene.anchor(c.frame)[0]))


def check_visibility(scene: PlanningScene, c: VisibilityConstraint) -> None:
    """Raise for what is wrong whatever the state is.

    Raises:
        UnknownNameError: no such frame or axis.
        InputError: a radius, an angle or a number of sides that cannot be.
    """
    scene.frame_pose(c.sensor)
    scene.frame_pose(c.frame)
    if c.view_axis not in AXES:
        raise UnknownNameError("view axis", c.view_axis, AXES)
    if not (np.isfinite(c.target_radius) and c.target_radius > 0):
        raise InputError(f"a target's radius is {c.target_radius:g} m, it must be positive")
    if c.cone_sides != int(c.cone_sides) or c.cone_sides < 3:
        raise InputError(f"a cone of {c.cone_sides} sides", cure="give at least 3")
    for what, angle in (("view", c.max_view_angle), ("range", c.max_range_angle)):
        if angle is not None and not 0 < angle <= np.pi:
            raise InputError(f"max_{what}_angle is {angle:g} rad", cure="give an angle in (0, pi], or None")


def _angle(a: Array, b: Array) -> float:
    """Between two vectors [rad], exact also where it is small."""
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))
