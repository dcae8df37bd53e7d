"""Pose estimation of known objects: fits of the shape to the points from all orientations.

A variant of iterated closest point (Besl and McKay, IEEE PAMI 14(2), 1992): closest points come from the
object's distance field, and rays that pass beside the object count, too.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, SO3, Box, Cylinder, Shape, Sphere
from armcell.perception import mesh_pose
from armcell.perception import solid_fit as F
from armcell.perception.depth_render import OWN, DepthEvidence
from armcell.perception.mesh_pose import Candidate, known_mesh
from armcell.perception.primitives import POINTS, RAYS, footprint
from armcell.perception.solid_fit import CameraEvidence, cost_at, fit_solid
from armcell.perception.solids import Solid, solid_of, surface_mesh

F64 = NDArray[np.float64]

_STARTS_POINTS, _STARTS_RAYS = 100, 60
_TRIED = 5  # number of refined start poses
_QUARTER = 4  # yaw steps per quarter turn for objects that are not primitives
_GOOD = 0.08  # cost below which no tilted pose is tried
_SURE, _FEWEST = 4.0, 8.0
"""A pose is significantly worse if its loss is larger by so many standard errors and by so many pixels."""
_CLOSE = 0.89  # error of a pixel whose depth differs by two scales
_TILTED = 0.7  # maximum cost of a tilted fit, relative to the resting fit


@dataclass(frozen=True, eq=False)
class Match:
    """Estimated pose of a known object in the frame of its support, with the errors of the match."""

    T: SE3
    cost: float
    rms: float  # [m]
    alternatives: tuple[SE3, ...] = ()  # other poses that explain the images about as well
    candidates: tuple[Candidate, ...] = ()  # poses to refine


@lru_cache(maxsize=1)
def cube_turns() -> tuple[SO3, ...]:
    """Return the 24 rotations that map the coordinate axes onto each other. They are start rotations for the
    pose search of a known object.
    """
    found = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            R = np.zeros((3, 3))
            for i, (k, sign) in enumerate(zip(order, signs, strict=True)):
                R[i, k] = sign
            if np.linalg.det(R) > 0:
                found.append(SO3(R))
    return tuple(found)


def rough_match(
    evidence: CameraEvidence, shapes: tuple[tuple[Shape, SE3], ...], stands: bool = True
) -> Match | None:
    """Estimate a rough pose of a known object quickly, from only some of the measured points and camera rays.

    The result is None if the object's size does not match.

    Args:
        stands: whether the object rests on z = 0.
    """
    solid = solid_of(shapes)
    around = footprint(evidence.points)
    seen = np.linalg.norm([around.a, around.b, around.height])
    if float(seen) > float(np.linalg.norm(solid.high - solid.low)) + 4 * evidence.scale:
        return None
    rough = evidence.thinned(_STARTS_POINTS, _STARTS_RAYS)
    starts = [
        (cost_at(rough, solid, T), i, T) for i, T in enumerate(_starts(evidence, shapes, solid, stands))
    ]
    starts.sort(key=lambda start: start[:2])
    tried = (fit_solid(rough, solid, F.SLIDING, np.zeros(3), T, 12) for _, _, T in starts[:_TRIED])
    best = min(tried, key=lambda found: found.cost)
    return Match(best.T, best.cost, best.rms)


def match_known(
    evidence: CameraEvidence, shapes: tuple[tuple[Shape, SE3], ...], start: Match, stands: bool = True
) -> Match:
    """Refine the pose of a known object from a rough match.

    Tilted poses are tried, too, and accepted if their cost is much lower.
    """
    solid, fine = solid_of(shapes), evidence.thinned(POINTS, RAYS)
    best = fit_solid(fine, solid, F.SLIDING, np.zeros(3), start.T, 20)
    if stands and best.cost < _GOOD:
        return Match(best.T, best.cost, best.rms)
    free = fit_solid(fine, solid, F.FREE, np.zeros(6), best.T, 25)
    chosen = free if not stands or free.cost < _TILTED * best.cost else best
    return Match(chosen.T, chosen.cost, chosen.rms)


def _starts(
    evidence: CameraEvidence, shapes: tuple[tuple[Shape, SE3], ...], solid: Solid, stands: bool
) -> list[SE3]:
    """Return start poses for matching a known object to camera points. The poses cover 24 axis-aligned
    orientations, so that each of the object's six sides is down in some poses.

    Each pose is centered on the footprint of the camera's points and takes its yaw angle from the footprint.
    If `stands` is set, the object rests on z = 0. Otherwise its center is at the mean height of the points.
    """
    points = _outline(shapes)
    around = footprint(evidence.points)
    primitive = len(shapes) == 1 and isinstance(shapes[0][0], Box | Cylinder | Sphere)
    angles = np.arange(1 if primitive else _QUARTER) * (np.pi / 2 / _QUARTER)
    middle = evidence.points.mean(axis=0)
    found = []
    for turn in cube_turns():
        for angle in angles:
            R = SO3.exp([0, 0, around.yaw + angle]) @ turn
            turned = points @ R.matrix.T
            low, high = turned.min(axis=0), turned.max(axis=0)
            z = -low[2] if stands else middle[2] - (low[2] + high[2]) / 2
            xy = np.array([around.x, around.y]) - (low[:2] + high[:2]) / 2
            found.append(SE3(R, np.array([xy[0], xy[1], z])))
    return found


@lru_cache(maxsize=64)
def _outline(shapes: tuple[tuple[Shape, SE3], ...]) -> F64:
    """Return the corners (n, 3) of the convex hull of a known object."""
    from scipy.spatial import ConvexHull

    vertices = surface_mesh(shapes).vertices
    return vertices[ConvexHull(vertices).vertices]


# --- meshes ---
def is_primitive(shapes: tuple[tuple[Shape, SE3], ...]) -> bool:
    """Return whether a known object is one box, cylinder or sphere. The symmetries of these shapes are
    known.
    """
    return len(shapes) == 1 and isinstance(shapes[0][0], Box | Cylinder | Sphere)


def rough_mesh_match(
    e: DepthEvidence,
    points: CameraEvidence,
    shapes: tuple[tuple[Shape, SE3], ...],
    span: float,
    partly: bool = False,
) -> Match | None:
    """Estimate a rough pose of a known object whose shape is a mesh, from coarse evidence. Return None if
    the object's size does not match.

    Args:
        span: [m] largest extent of the cluster.
        partly: whether the cluster may be only a corner of the mesh.
    """
    mesh = known_mesh(shapes)
    if span > mesh.diameter + 4 * e.scale:
        return None
    found = mesh_pose.search(e, points, mesh, partly)
    errors, near = mesh_pose.pixel_errors(e, mesh, found[0].T)
    return Match(found[0].T, _mean_loss(errors, near), np.inf, candidates=tuple(found))


def match_mesh(
    coarse: DepthEvidence, e: DepthEvidence, shapes: tuple[tuple[Shape, SE3], ...], start: Match, prior: SE3
) -> Match:
    """Refine the rough pose of a known object whose shape is a mesh, and find the object's other poses that
    explain the images about as well.

    Args:
        prior: pose in the frame of the support; of equal poses of a symmetric mesh, the nearest one is
            returned.
    """
    mesh = known_mesh(shapes)
    found = mesh_pose.settle(coarse, e, mesh, list(start.candidates))
    errors, near = mesh_pose.pixel_errors(e, mesh, found[0].T)
    others = []
    for other in found[1:]:
        if not _surely_worse(mesh_pose.pixel_errors(e, mesh, other.T)[0], errors):
            others.append(other.T)
    best = found[0].T
    equal = closest_equivalent(shapes, best, prior)
    if equal.distance_to(best)[1] > 1e-3:  # a scanned mesh is symmetric only within the tolerance
        equal = mesh_pose.refit(e, mesh, equal)
        again, shown = mesh_pose.pixel_errors(e, mesh, equal)
        if not _surely_worse(again, errors):
            best, errors, near = equal, again, shown
    close = np.abs(errors[near]) < _CLOSE
    r2 = errors[near][close] ** 2
    rms = float(e.scale * np.sqrt(np.mean(r2 / (1 - r2)))) if len(r2) else np.inf
    return Match(best, _mean_loss(errors, near), rms, tuple(others))


def unexplained(
    e: DepthEvidence, points: CameraEvidence, shapes: tuple[tuple[Shape, SE3], ...], T: SE3
) -> float:
    """Return the mean loss, from 0 to 1, of the points of one cluster for a known object at a given pose.
    Other pixels and rays do not count.
    """
    if is_primitive(shapes):
        return cost_at(points.thinned(POINTS, 0), solid_of(shapes), T)
    errors, _ = mesh_pose.pixel_errors(e, known_mesh(shapes), T)
    own = (e.kinds == OWN) & (e.depth > 0)
    return float(np.mean(errors[: len(own)][own] ** 2)) if own.any() else 1.0


def _surely_worse(errors: F64, than: F64) -> bool:
    """Return whether one pose of a known object explains the images significantly worse than another. The
    pixel errors of the two poses are `errors` and `than`.

    Each pixel is one observation of the difference of both losses.
    """
    more = errors**2 - than**2
    return bool(more.sum() > max(_SURE * np.sqrt((more**2).sum()), _FEWEST))


def _mean_loss(errors: F64, near: NDArray[np.bool_]) -> float:
    return float(np.mean(errors[near] ** 2)) if near.any() else 1.0


# --- symmetry ---
def closest_equivalent(shapes: tuple[tuple[Shape, SE3], ...], T: SE3, prior: SE3) -> SE3:
    """Return the pose nearest to `prior` among all poses in which a known, symmetric object looks the same as
    at its pose T.

    Two poses are equivalent if the object looks the same in both of them because it is symmetric.

    The symmetry of boxes, cylinders and spheres is exact; that of meshes holds for the tolerance of matching.
    """
    if not is_primitive(shapes):
        return min(
            (T @ S for S in known_mesh(shapes).symmetries),
            key=lambda one: _angle(one.rotation, prior.rotation),
        )
    shape, T_object_shape = shapes[0]
    wanted, here = prior @ T_object_shape, T @ T_object_shape
    match shape:
        case Sphere():
            R = wanted.rotation
        case Cylinder():
            R = _spun(here.rotation, wanted.rotation)
        case Box():
            half = shape.half_extents
            same = (t for t in cube_turns() if np.allclose(np.abs(t.matrix) @ half, half, atol=1e-6))
            R = min((here.rotation @ t for t in same), key=lambda r: _angle(r, wanted.rotation))
        case _:
            return T
    return SE3(R, here.translation) @ T_object_shape.inverse()


def _angle(a: SO3, b: SO3) -> float:
    return float(np.linalg.norm((a.inverse() @ b).log()))


def _spun(here: SO3, wanted: SO3) -> SO3:
    """Return the rotation nearest to `wanted` in which a known cylindrical object has the same axis as in
    `here`: the z axes are parallel or antiparallel.
    """
    axis = here.matrix[:, 2]
    if axis @ wanted.matrix[:, 2] < 0:
        axis = -axis
    return SO3.between(wanted.matrix[:, 2], axis) @ wanted


def is_symmetric(shapes: tuple[tuple[Shape, SE3], ...]) -> bool:
    """Return whether a known object looks the same in several poses."""
    return is_primitive(shapes) or len(known_mesh(shapes).symmetries) > 1


def pose_error(shapes: tuple[tuple[Shape, SE3], ...], T: SE3, T_true: SE3) -> tuple[float, float]:
    """Return the position error [m] and rotation error [rad] of a known object's pose. Symmetric poses count
    as equal.
    """
    return closest_equivalent(shapes, T, T_true).distance_to(T_true)
