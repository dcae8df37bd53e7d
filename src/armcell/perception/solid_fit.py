"""Fit of a solid to camera evidence: points on its surface, and rays that pass beside it.

Points alone do not show where a face ends that the camera sees from straight above; the rays that pass
beside the face do. The Levenberg-Marquardt method (Marquardt, SIAM J. 11(2), 1963) minimizes the residuals
with Geman-McClure weights, so that points of other objects hardly count.

All values are in the support's frame: z = 0 is the support plane, and z points away from it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from armcell.core import SE3
from armcell.perception.solids import GRID, Solid, solid_distance

F64 = NDArray[np.float64]

FREE, SLIDING, BOX_STANDS, CYLINDER_STANDS, CYLINDER_LIES, BALL_LIES = range(6)
"""Modes of a fit by free parameters: pose; x, y and yaw; x, y, yaw and sizes of a box; etc.

The solids of the last four modes rest on the support plane.
"""
_LEAST = 0.002  # [m] smallest size of a fitted solid


class CameraEvidence(NamedTuple):
    """Camera evidence for fitting a solid to an object: points (n, 3) on the object,
    and rays that pass beside it. Kernels take it as one argument.

    The rays start at `eyes` (m, 3), have unit directions `rays` (m, 3), and are free up to `free_to` (m,)
    [m].
    """

    points: F64
    eyes: F64
    rays: F64
    free_to: F64
    scale: float  # [m] larger residuals have less and less weight

    def thinned(self, points: int, rays: int) -> CameraEvidence:
        """Return a subset of the camera evidence that has about the given
        numbers of points and rays, to fit a solid faster.

        The subset is evenly distributed.
        """
        i = _every(len(self.points), points)
        k = _every(len(self.rays), rays)
        return CameraEvidence(self.points[i], self.eyes[k], self.rays[k], self.free_to[k], self.scale)


def _every(count: int, wanted: int) -> NDArray[np.int64]:
    if count <= wanted:
        return np.arange(count)
    return np.linspace(0, count - 1, wanted).astype(np.int64)


@dataclass(frozen=True, eq=False)
class Fit:
    """A solid fitted to camera evidence: its pose T_support_solid, its parameters, and how well it fits."""

    mode: int
    parameters: F64
    T: SE3
    size: F64  # (3,) size of a primitive, as in solids.Solid
    cost: float  # mean robust loss of the residuals: 0 perfect, 1 worst
    rms: float  # [m] rms of the points with residuals up to three scales


def fit_solid(
    evidence: CameraEvidence, solid: Solid, mode: int, start: F64, T0: SE3, iterations: int = 25
) -> Fit:
    """Fit a solid to camera evidence, starting near the given parameters.

    Args:
        start: parameters of the mode. FREE: rotation vector and translation from T0. SLIDING: x, y, yaw from
            T0. BOX_STANDS: x, y, yaw and full sizes. CYLINDER_STANDS: x, y, radius, length.
            CYLINDER_LIES: x, y, yaw, radius, length. BALL_LIES: x, y, radius.
        T0: T_support_solid from which FREE and SLIDING start.
    """
    base = T0.matrix[:3].ravel()
    parameters, cost = _solve(np.array(start, float), mode, base, evidence, solid, solid.radius, iterations)
    return evaluate_fit(evidence, solid, mode, parameters, T0, cost)


def evaluate_fit(e: CameraEvidence, solid: Solid, mode: int, parameters: F64, T0: SE3, cost: float) -> Fit:
    R, t, size = np.empty((3, 3)), np.empty(3), np.empty(3)
    _place(mode, parameters, T0.matrix[:3].ravel(), R, t, size)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, t
    fitted = solid if mode in (FREE, SLIDING) else solid._replace(sizes=size[None])
    r = _point_residuals(e.points, R, t, fitted)
    near = r[np.abs(r) <= 3 * e.scale]
    rms = float(np.sqrt(np.mean(near**2))) if len(near) else np.inf
    return Fit(mode, parameters, SE3.from_matrix(T), size, cost, rms)


def cost_at(evidence: CameraEvidence, solid: Solid, T: SE3) -> float:
    """Return how well a fitted solid at a given pose explains the camera evidence: 0 is perfect and 1 is
    worst.
    """
    base = T.matrix[:3].ravel()
    return float(_cost_of(np.zeros(3), SLIDING, base, evidence, solid, solid.radius))


@njit(cache=True)
def _place(mode, p, base, R, t, size):
    """Write the pose (R, t) and the size of a fitted solid,
    computed from the parameters of the fit, into given arrays.
    """
    size[:] = 0.0
    if mode == FREE:
        w = p[:3]
        angle = np.sqrt(w[0] ** 2 + w[1] ** 2 + w[2] ** 2)
        a = np.sin(angle) / angle if angle > 1e-9 else 1.0
        b = (1 - np.cos(angle)) / angle**2 if angle > 1e-6 else 0.5
        x, y, z = w
        K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        turn = np.eye(3) + a * K + b * (K @ K)
        for i in range(3):
            t[i] = base[4 * i + 3] + p[3 + i]
            for k in range(3):
                R[i, k] = turn[i, 0] * base[k] + turn[i, 1] * base[4 + k] + turn[i, 2] * base[8 + k]
        return
    yaw = 0.0
    if mode in (SLIDING, BOX_STANDS, CYLINDER_LIES):
        yaw = p[2]
    c, s = np.cos(yaw), np.sin(yaw)
    if mode == SLIDING:
        for k in range(3):
            R[0, k] = c * base[k] - s * base[4 + k]
            R[1, k] = s * base[k] + c * base[4 + k]
            R[2, k] = base[8 + k]
        t[0], t[1], t[2] = base[3] + p[0], base[7] + p[1], base[11]
        return
    R[:, :] = 0.0
    t[0], t[1] = p[0], p[1]
    if mode == CYLINDER_LIES:  # the cylinder's x axis is up, its z axis is along (c, s, 0)
        R[2, 0] = 1.0
        R[0, 1], R[1, 1] = s, -c
        R[0, 2], R[1, 2] = c, s
        size[0], size[1] = p[3], p[4] / 2
        t[2] = p[3]
        return
    R[0, 0], R[0, 1], R[1, 0], R[1, 1], R[2, 2] = c, -s, s, c, 1.0
    if mode == BOX_STANDS:
        size[0], size[1], size[2] = p[3] / 2, p[4] / 2, p[5] / 2
        t[2] = p[5] / 2
    elif mode == CYLINDER_STANDS:
        size[0], size[1] = p[2], p[3] / 2
        t[2] = p[3] / 2
    else:
        size[0] = p[2]
        t[2] = p[2]


@njit(cache=True)
def _at(solid, R, t, x, y, z):
    a, b, c = x - t[0], y - t[1], z - t[2]
    return solid_distance(
        solid, R[0, 0] * a + R[1, 0] * b + R[2, 0] * c, R[0, 1] * a + R[1, 1] * b + R[2, 1] * c,
        R[0, 2] * a + R[1, 2] * b + R[2, 2] * c,
    )  # fmt: skip


@njit(cache=True)
def _on_ray(solid, R, t, eye, ray, depth):
    return _at(solid, R, t, eye[0] + depth * ray[0], eye[1] + depth * ray[1], eye[2] + depth * ray[2])


@njit(cache=True)
def _point_residuals(points, R, t, solid):
    out = np.empty(len(points))
    for i in range(len(points)):
        out[i] = _at(solid, R, t, points[i, 0], points[i, 1], points[i, 2])
    return out


@njit(cache=True)
def _depth_of_ray(solid, R, t, eye, ray, free_to, reach, convex):
    """Return how deep [m] a camera ray penetrates a fitted solid within the distance that the camera measured
    as free. The depth is 0 if the ray passes beside the solid.

    The distance to a convex solid is convex along a line, so golden section finds its minimum.
    """
    middle = 0.0
    off = 0.0
    for d in range(3):
        middle += (t[d] - eye[d]) * ray[d]
    for d in range(3):
        off += (eye[d] + middle * ray[d] - t[d]) ** 2
    if off >= reach * reach:
        return 0.0
    half = np.sqrt(reach * reach - off)
    a, b = max(middle - half, 0.0), min(middle + half, free_to)
    if b <= a:
        return 0.0
    least = np.inf
    if convex:
        g = 0.6180339887498949
        c, d = b - g * (b - a), a + g * (b - a)
        fc = _on_ray(solid, R, t, eye, ray, c)
        fd = _on_ray(solid, R, t, eye, ray, d)
        for _ in range(11):
            if fc < fd:
                b, d, fd = d, c, fc
                c = b - g * (b - a)
                fc = _on_ray(solid, R, t, eye, ray, c)
            else:
                a, c, fc = c, d, fd
                d = a + g * (b - a)
                fd = _on_ray(solid, R, t, eye, ray, d)
            if min(fc, fd) > b - a:  # a distance changes by at most 1 m per meter
                break
        least = min(fc, fd)
    else:
        for k in range(16):
            s = a + (b - a) * k / 15.0
            f = _on_ray(solid, R, t, eye, ray, s)
            least = min(least, f)
    return max(-least, 0.0)


@njit(cache=True)
def _residuals(p, mode, base, e, solid, radius, out):
    R, t, size = np.empty((3, 3)), np.empty(3), np.empty(3)
    _place(mode, p, base, R, t, size)
    sizes, reach = solid.sizes, radius
    if mode >= BOX_STANDS:
        sizes = size.reshape(1, 3)
        if mode == BOX_STANDS:
            reach = np.sqrt(size[0] ** 2 + size[1] ** 2 + size[2] ** 2)
        else:
            reach = np.sqrt(size[0] ** 2 + size[1] ** 2)
    fitted = Solid(
        solid.kinds, sizes, solid.poses, solid.grid, solid.origin, solid.step, solid.low, solid.high
    )
    convex = len(solid.kinds) == 1 and solid.kinds[0] != GRID
    n = len(e.points)
    for i in range(n):
        out[i] = _at(fitted, R, t, e.points[i, 0], e.points[i, 1], e.points[i, 2])
    for i in range(len(e.rays)):
        out[n + i] = _depth_of_ray(fitted, R, t, e.eyes[i], e.rays[i], e.free_to[i], reach, convex)


@njit(cache=True)
def _robust(r, scale):
    """Return the mean Geman-McClure loss, from 0 to 1, of the residuals (m,) [m] of a fitted solid.

    A residual of `scale` [m] has the loss 1/2.
    """
    total = 0.0
    for x in r:
        q = (x / scale) ** 2
        total += q / (1 + q)
    return total / max(len(r), 1)


@njit(cache=True)
def _cost_of(p, mode, base, e, solid, radius):
    r = np.empty(len(e.points) + len(e.rays))
    _residuals(p, mode, base, e, solid, radius, r)
    return _robust(r, e.scale)


@njit(cache=True)
def _bounded(p, mode):
    first = 3
    if mode in (FREE, SLIDING):
        return
    if mode in (CYLINDER_STANDS, BALL_LIES):
        first = 2
    for k in range(first, len(p)):
        p[k] = max(p[k], _LEAST)


@njit(cache=True)
def _solve(p, mode, base, e, solid, radius, iterations):
    m, n = len(e.points) + len(e.rays), len(p)
    r, r2 = np.empty(m), np.empty(m)
    J = np.empty((m, n))
    _residuals(p, mode, base, e, solid, radius, r)
    cost = _robust(r, e.scale)
    damping = 1e-3
    for _ in range(iterations):
        h = 1e-5
        for k in range(n):
            q = p.copy()
            q[k] += h
            _residuals(q, mode, base, e, solid, radius, r2)
            for i in range(m):
                J[i, k] = (r2[i] - r[i]) / h
        A, g = np.zeros((n, n)), np.zeros(n)
        for i in range(m):
            w = 1.0 / (1.0 + (r[i] / e.scale) ** 2) ** 2
            for a in range(n):
                g[a] += w * J[i, a] * r[i]
                for b in range(a + 1):
                    A[a, b] += w * J[i, a] * J[i, b]
        for a in range(n):
            for b in range(a):
                A[b, a] = A[a, b]
        better = False
        for _ in range(6):
            D = A.copy()
            for a in range(n):
                D[a, a] += damping * A[a, a] + 1e-9
            step_ = np.linalg.solve(D, -g)
            q = p + step_
            _bounded(q, mode)
            _residuals(q, mode, base, e, solid, radius, r2)
            new = _robust(r2, e.scale)
            if new < cost:
                better = cost - new > 1e-5 * cost
                p, cost, damping = q, new, max(damping / 5, 1e-9)
                r[:] = r2
                break
            damping *= 6
        if not better:
            break
    return p, cost
