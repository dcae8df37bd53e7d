"""Fits of boxes, cylinders and spheres of unknown size to a point cluster, best first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, Box, Cylinder, Shape, Sphere
from armcell.perception import solid_fit as F
from armcell.perception.solid_fit import CameraEvidence, Fit, fit_solid
from armcell.perception.solids import BOX, CYLINDER, SPHERE, primitive

F64 = NDArray[np.float64]

FIRST_POINTS, FIRST_RAYS = 120, 80
POINTS, RAYS = 400, 200
"""Numbers of points and rays in the final fits (the first fits of all starts use fewer)."""
NEAR = 3.0  # maximum cost, relative to the best first fit, of kinds that are refined
GOOD = 0.05  # kinds with at most this cost are always refined


@dataclass(frozen=True, eq=False)
class Footprint:
    """Footprint of a point cluster, to which primitives are fitted: the smallest rectangle that contains the
    cluster seen from above, and the cluster's height.
    """

    x: float
    y: float
    yaw: float
    a: float  # [m] along yaw
    b: float
    height: float


def footprint(points: F64) -> Footprint:
    """Return the footprint of a point cluster, to which primitives are fitted: the smallest rectangle that
    contains the points (n, 3) seen from above.

    The rectangle has an edge of the convex hull (Freeman and Shapira, Communications of the ACM 18(7), 1975).
    """
    from scipy.spatial import ConvexHull, QhullError

    flat = points[:, :2]
    height = float(np.percentile(points[:, 2], 98))
    try:
        corners = flat[ConvexHull(flat).vertices]
    except (QhullError, ValueError):  # collinear points
        middle = flat.mean(axis=0)
        reach = float(np.ptp(flat, axis=0).max()) + 1e-3
        return Footprint(middle[0], middle[1], 0.0, reach, reach, height)
    edges = np.roll(corners, -1, axis=0) - corners
    best, found = np.inf, None
    for angle in np.arctan2(edges[:, 1], edges[:, 0]):
        c, s = np.cos(angle), np.sin(angle)
        turned = corners @ np.array([[c, -s], [s, c]])
        low, high = turned.min(axis=0), turned.max(axis=0)
        area = float(np.prod(high - low))
        if area < best:
            middle = (low + high) / 2 @ np.array([[c, s], [-s, c]])
            x, y = (float(v) for v in middle)
            a, b = (float(v) for v in high - low)
            best, found = area, Footprint(x, y, float(angle), a, b, height)
    assert found is not None
    return found


@dataclass(frozen=True, eq=False)
class PrimitiveFit:
    """Primitive shape that was fitted to a point cluster, with its pose in the frame of the support."""

    shape: Shape
    T: SE3
    cost: float
    rms: float  # [m]

    @property
    def kind(self) -> str:
        return type(self.shape).__name__.lower()


def fit_primitives(evidence: CameraEvidence) -> list[PrimitiveFit]:
    """Fit boxes, cylinders and spheres that rest on the plane z = 0 to a cluster of points.
    The best fit comes first.
    """
    rough = evidence.thinned(FIRST_POINTS, FIRST_RAYS)
    fits = sorted((_tried(rough, *start, iterations=12) for start in _starts(evidence.points)), key=_cost)
    fine, seen = evidence.thinned(POINTS, RAYS), set()
    guesses = []
    for first in fits:
        if first.mode not in seen and first.cost <= max(NEAR * fits[0].cost, GOOD):
            seen.add(first.mode)
            guesses.append(_guess(_tried(fine, first.mode, first.parameters, iterations=25)))
    return sorted(guesses, key=lambda guess: guess.cost)


def _cost(found: Fit) -> float:
    return found.cost


def _tried(evidence: CameraEvidence, mode: int, start: F64, iterations: int) -> Fit:
    kind = {F.BOX_STANDS: BOX, F.BALL_LIES: SPHERE}.get(mode, CYLINDER)
    return fit_solid(evidence, primitive(kind, (0.05, 0.05, 0.05)), mode, start, SE3.identity(), iterations)


def _starts(points: F64) -> list[tuple[int, F64]]:
    f = footprint(points)
    a, b, h = max(f.a, 0.005), max(f.b, 0.005), max(f.height, 0.005)
    radius = (a + b) / 4
    starts = [
        (F.BOX_STANDS, [f.x, f.y, f.yaw, a, b, h]),
        (F.BOX_STANDS, [f.x, f.y, f.yaw + np.pi / 4, radius * 1.4, radius * 1.4, h]),
        (F.CYLINDER_STANDS, [f.x, f.y, radius, h]),
        (F.CYLINDER_LIES, [f.x, f.y, f.yaw, h / 2, a]),
        (F.CYLINDER_LIES, [f.x, f.y, f.yaw + np.pi / 2, h / 2, b]),
    ]
    ball = _ball(points)
    starts.append((F.BALL_LIES, [f.x, f.y, h / 2] if ball is None else list(ball)))
    return [(mode, np.array(start)) for mode, start in starts]


def _ball(points: F64) -> tuple[float, float, float] | None:
    """Fit a sphere that rests on the plane z = 0 to a cluster of points by linear least squares.
    Return its x, y and radius.

    (x - a)^2 + (y - b)^2 + z^2 - 2 r z = 0.
    """
    x, y, z = points.T
    A = np.column_stack([2 * x, 2 * y, 2 * z, -np.ones(len(x))])
    solution, _, rank, _ = np.linalg.lstsq(A, x**2 + y**2 + z**2, rcond=None)
    a, b, r, _ = solution
    return (float(a), float(b), float(r)) if rank == 4 and 0.003 < r < 1.0 else None


def _guess(found: Fit) -> PrimitiveFit:
    a, b, c = (float(v) for v in found.size)
    match found.mode:
        case F.BOX_STANDS:
            shape: Shape = Box(2 * a, 2 * b, 2 * c)
        case F.BALL_LIES:
            shape = Sphere(a)
        case _:
            shape = Cylinder(a, 2 * b)
    return PrimitiveFit(shape, found.T, found.cost, found.rms)
