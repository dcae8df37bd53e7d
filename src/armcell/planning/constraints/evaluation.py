"""Evaluation of constraints at joint positions.

The functions compute errors, violations as text, and distances to shapes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core import (
    SE3,
    SO3,
    Box,
    Capsule,
    Cone,
    Constraints,
    Cylinder,
    InputError,
    JointConstraint,
    OrientationConstraint,
    Plane,
    PositionConstraint,
    Shape,
    Sphere,
    UnknownNameError,
    VisibilityConstraint,
)
from armcell.planning.constraints.visibility import visibility
from armcell.planning.moved_frame import MovedFrame, with_joint_positions
from armcell.scene import PlanningScene

Array = NDArray[np.float64]

ROUNDING = 1e-6  # [rad or m] excess that counts as rounding: the accuracy of inverse kinematics
PARAMETERIZATIONS = ("rotation_vector", "xyz_euler")


@dataclass(frozen=True, eq=False)
class ConstraintResidual:
    """Error of given joint positions with respect to one constraint.

    `error` is, for a joint, the difference from the constraint's position (1,) [rad or m]; for a point, the
    distance from its region (1,) [m], 0 inside; for an orientation, the rotation error (3,) [rad]; for a view
    (3,), see `visibility`. `excess` (same shape) is the part of the error beyond the tolerance.
    """

    constraint: JointConstraint | PositionConstraint | OrientationConstraint | VisibilityConstraint
    error: Array
    excess: Array
    words: str

    @property
    def ok(self) -> bool:
        """Whether the evaluated joint positions satisfy the constraint, apart from rounding errors."""
        return bool(np.all(self.excess <= ROUNDING))


def constraint_errors(
    scene: PlanningScene, group: str, constraints: Constraints, q: ArrayLike
) -> tuple[ConstraintResidual, ...]:
    """Evaluate every constraint at joint positions q, and return one error for each constraint.

    Order: joints, positions, orientations, visibilities.

    Args:
        q: positions (n,) of the group's joints; other joints keep their position in the scene.
    Raises:
        UnknownNameError: a joint, link or frame that does not exist.
        InputError: a region shape without an inside, or an unknown parameterization.
    """
    at = with_joint_positions(scene, scene.model.group(group).joint_names, q)
    return (
        *(_joint(at, c) for c in constraints.joints),
        *(_position(at, group, c) for c in constraints.positions),
        *(_orientation(at, group, c) for c in constraints.orientations),
        *(ConstraintResidual(c, *visibility(at, c)) for c in constraints.visibilities),
    )


def satisfies_constraints(scene: PlanningScene, group: str, constraints: Constraints, q: ArrayLike) -> bool:
    """Evaluate all constraints at joint positions q (n,) of the group, and return whether all of them are
    satisfied.

    See `constraint_errors`.
    """
    return all(error.ok for error in constraint_errors(scene, group, constraints, q))


def describe_violations(scene: PlanningScene, group: str, constraints: Constraints, q: ArrayLike) -> str:
    """Describe which constraints joint positions q (n,) violate and by how much; return "" if they satisfy
    all constraints.
    """
    return "; ".join(e.words for e in constraint_errors(scene, group, constraints, q) if not e.ok)


def _joint(scene: PlanningScene, c: JointConstraint) -> ConstraintResidual:
    value = scene.positions[scene.model.columns((c.joint,))[0]]
    error = value - c.position
    excess = max(error - c.tolerance_above, -c.tolerance_below - error, 0.0)
    words = (
        f"joint {c.joint} at {value:.4g} is {excess:.3g} outside of "
        f"[{c.position - c.tolerance_below:.4g}, {c.position + c.tolerance_above:.4g}]"
    )
    return ConstraintResidual(c, np.array([error]), np.array([excess]), words)


def _position(scene: PlanningScene, group: str, c: PositionConstraint) -> ConstraintResidual:
    T_world_link, name = _pose(scene, group, c.link)
    point = T_world_link.apply(c.point)
    distance = region_distance(scene, c, point)
    words = f"{name} is {distance * 1000:.1f} mm outside of its region"
    return ConstraintResidual(c, np.array([distance]), np.array([distance]), words)


def region_distance(scene: PlanningScene, c: PositionConstraint, point: ArrayLike) -> float:
    """Return the distance [m] between a point in the world (3,) and the region of a position constraint; 0
    inside the region.
    """
    at = scene.frame_pose(c.frame).inverse().apply(point)
    return min(distance_to_shape(shape, T.inverse().apply(at)) for shape, T in c.region)


def _orientation(scene: PlanningScene, group: str, c: OrientationConstraint) -> ConstraintResidual:
    T_world_link, name = _pose(scene, group, c.link)
    wanted = scene.frame_pose(c.frame).rotation @ c.rotation
    error = rotation_error(wanted, T_world_link.rotation, c.parameterization)
    tolerance = np.asarray(c.tolerance, dtype=float)
    excess = np.where(tolerance >= np.pi, 0.0, np.maximum(np.abs(error) - tolerance, 0.0))
    k = int(np.argmax(excess))
    words = f"{name} is turned {np.rad2deg(excess[k]):.2f} deg too far about {'xyz'[k]} of the wanted frame"
    return ConstraintResidual(c, error, excess, words)


def _pose(scene: PlanningScene, group: str, name: str | None) -> tuple[SE3, str]:
    moved_frame = MovedFrame(scene, group, name)
    return scene.frame_pose(moved_frame.name), moved_frame.name


def rotation_error(wanted: SO3, present: SO3, parameterization: str) -> Array:
    """Return the error (3,) [rad] of an orientation constraint, the rotation from the desired to the current
    orientation.
    """
    turn = wanted.inverse() @ present
    if parameterization == "rotation_vector":
        return turn.log()
    if parameterization != "xyz_euler":
        raise UnknownNameError("parameterization", parameterization, PARAMETERIZATIONS)
    # Rx(a) Ry(b) Rz(c): the transpose of Rz(-c) Ry(-b) Rx(-a), whose angles rpy gives.
    return -turn.inverse().rpy


def rotation_of(error: ArrayLike, parameterization: str) -> SO3:
    """Convert the error (3,) of an orientation constraint back to a rotation; this is the inverse of
    `rotation_error`.
    """
    if parameterization == "rotation_vector":
        return SO3.exp(error)
    return SO3.from_rpy(-np.asarray(error, dtype=float)).inverse()


def _beyond(over: ArrayLike) -> float:
    return float(np.linalg.norm(np.maximum(over, 0.0)))


def _to_segment(p: Array, a: Array, b: Array) -> float:
    t = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
    return float(np.linalg.norm(p - a - t * (b - a)))


def _to_view_cone(s: Cone, p: Array) -> float:
    r, z, half = float(np.hypot(p[0], p[1])), float(p[2]), s.length / 2
    if -half <= z <= half and r <= s.radius * (half - z) / s.length:
        return 0.0
    at, rim, apex = np.array([r, z]), np.array([s.radius, -half]), np.array([0.0, half])
    return min(_to_segment(at, rim, apex), _to_segment(at, np.array([0.0, -half]), rim))


_DISTANCES: dict[type, Callable[..., float]] = {
    Box: lambda s, p: _beyond(np.abs(p) - s.half_extents),
    Sphere: lambda s, p: _beyond(np.linalg.norm(p) - s.radius),
    Cylinder: lambda s, p: _beyond((np.hypot(p[0], p[1]) - s.radius, abs(p[2]) - s.length / 2)),
    Capsule: lambda s, p: _beyond(
        np.linalg.norm(p - (0, 0, np.clip(p[2], -s.length / 2, s.length / 2))) - s.radius
    ),
    Cone: _to_view_cone,
    Plane: lambda s, p: _beyond(p[2]),
}


def distance_to_shape(shape: Shape, point: ArrayLike) -> float:
    """Return the distance [m] between a point (3,) and a shape of a constraint region, in the frame of the
    shape; 0 inside the shape.

    Raises:
        InputError: the shape is a mesh, cloud or octree: these are surfaces, not regions.
    """
    if type(shape) not in _DISTANCES:
        known = ", ".join(sorted(kind.__name__ for kind in _DISTANCES))
        raise InputError(f"a {type(shape).__name__} cannot be a region; these can: {known}")
    return _DISTANCES[type(shape)](shape, np.asarray(point, dtype=float))
