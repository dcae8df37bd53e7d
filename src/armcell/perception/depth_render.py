"""Comparison of a mesh's rendered depth with everything that cameras see around a cluster of points.

Each pixel is evidence: where the mesh hides what the camera saw behind it (free space), where it leaves
points of the cluster unexplained (silhouette), and where both depths differ (visible surface). The support is
evidence, too: no mesh reaches below it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from armcell.core import SE3, Pinhole

F64 = NDArray[np.float64]

FREE, OWN, OTHER = 0, 1, 2
"""Kinds of pixels: background and support; the cluster; a thing that may hide the object."""
_BAND = 4.0  # [scales] pixels so near to the support show low parts of the object
_FAR = 3.0  # [scales] larger differences of depth count as equally wrong
_NEAREST = 0.02  # [m] triangles that are nearer to the camera are not drawn
SUNK = 50
"""Number of pixels whose loss equals that of a mesh far below its support, which thousands of pixels show."""


class DepthEvidence(NamedTuple):
    """Depth images around a point cluster, to compare with the rendered depth of a mesh. The images are
    cropped and concatenated. Kernels take them as one argument.

    The pixels (n,) of all images have a depth [m] (0 where the camera measured none), the depth of the
    support plane [m] (inf beside it), and a kind. `sizes` (v, 3) are each image's first pixel, height and
    width; `cameras` (v, 16) are fx, fy, cx, cy, and rotation and translation of T_camera_support.
    """

    depth: F64
    floor: F64
    kinds: NDArray[np.uint8]
    sizes: NDArray[np.int64]
    cameras: F64
    scale: float  # [m] difference of depth with the loss 1/2


def cut_out(
    depth: NDArray[np.floating], kinds: NDArray[np.uint8], pinhole: Pinhole, T_camera_support: SE3,
    scale: float, margin: int, most: int,
) -> DepthEvidence:  # fmt: skip
    """Crop a depth image (h, w) [m] to the surroundings of a point cluster, for the comparison with rendered
    depth.

    Args:
        kinds: (h, w) kind of each pixel.
        margin: [px] width of the surroundings.
        most: maximum number of pixels; if there are more, every second (third, ...) row and column is kept.
    """
    v, u = np.nonzero(kinds == OWN)
    v0, v1 = max(v.min() - margin, 0), min(v.max() + margin + 1, depth.shape[0])
    u0, u1 = max(u.min() - margin, 0), min(u.max() + margin + 1, depth.shape[1])
    step = int(np.ceil(np.sqrt((v1 - v0) * (u1 - u0) / most)))
    part = np.s_[v0:v1:step, u0:u1:step]
    z = np.where(np.isfinite(depth[part]) & (depth[part] > 0), depth[part], 0.0).astype(float)
    m, T = pinhole, T_camera_support
    inner = np.array([m.fx / step, m.fy / step, (m.cx - u0) / step, (m.cy - v0) / step])
    x = (np.arange(z.shape[1]) - inner[2]) / inner[0]
    y = ((np.arange(z.shape[0]) - inner[3]) / inner[1])[:, None]
    n = T.rotation.matrix[:, 2]  # the support's normal, seen from the camera
    along = n[0] * x + n[1] * y + n[2]
    with np.errstate(divide="ignore", invalid="ignore"):
        floor = float(n @ T.translation) / along
    floor = np.where(np.isfinite(floor) & (floor > 0), floor, np.inf)
    return DepthEvidence(
        z.ravel(), floor.ravel(), np.ascontiguousarray(kinds[part]).ravel(), np.array([[0, *z.shape]]),
        np.concatenate([inner, T.rotation.matrix.ravel(), T.translation])[None], scale,
    )  # fmt: skip


def joined(views: list[DepthEvidence]) -> DepthEvidence:
    """Combine the depth evidence of several cameras, for the comparison with the rendered depth of a mesh."""
    sizes = np.concatenate([e.sizes for e in views])
    counts = sizes[:, 1] * sizes[:, 2]
    sizes[:, 0] = np.cumsum(counts) - counts
    return DepthEvidence(
        np.concatenate([e.depth for e in views]), np.concatenate([e.floor for e in views]),
        np.concatenate([e.kinds for e in views]), sizes, np.concatenate([e.cameras for e in views]),
        max(e.scale for e in views),
    )  # fmt: skip


@njit(cache=True)
def draw(vertices, faces, closed, R, t, e, out):
    """Render the depth (n,) [m] of a mesh at the pose (R, t) for each pixel of the images; inf where the mesh
    is not seen.

    A pixel shows the surface at its center. 1 / z is linear in the image, also within a triangle. Of a closed
    mesh, the triangles that face away are hidden.
    """
    out[:] = 0.0  # 1 / z until all triangles are drawn
    n = len(vertices)
    us, vs, ws = np.empty(n), np.empty(n), np.empty(n)
    M, p = np.empty((3, 3)), np.empty(3)
    for k in range(len(e.sizes)):
        c = e.cameras[k]
        for i in range(3):
            p[i] = c[13 + i] + c[4 + 3 * i] * t[0] + c[5 + 3 * i] * t[1] + c[6 + 3 * i] * t[2]
            for j in range(3):
                M[i, j] = c[4 + 3 * i] * R[0, j] + c[5 + 3 * i] * R[1, j] + c[6 + 3 * i] * R[2, j]
        for i in range(n):
            a, b, d = vertices[i, 0], vertices[i, 1], vertices[i, 2]
            z = M[2, 0] * a + M[2, 1] * b + M[2, 2] * d + p[2]
            if z < _NEAREST:
                ws[i] = 0.0
                continue
            ws[i] = 1.0 / z
            us[i] = c[0] * (M[0, 0] * a + M[0, 1] * b + M[0, 2] * d + p[0]) * ws[i] + c[2]
            vs[i] = c[1] * (M[1, 0] * a + M[1, 1] * b + M[1, 2] * d + p[1]) * ws[i] + c[3]
        first, h, w = e.sizes[k, 0], e.sizes[k, 1], e.sizes[k, 2]
        for f in range(len(faces)):
            i, j, m = faces[f, 0], faces[f, 1], faces[f, 2]
            if ws[i] == 0.0 or ws[j] == 0.0 or ws[m] == 0.0:
                continue
            au, av = us[j] - us[i], vs[j] - vs[i]
            bu, bv = us[m] - us[i], vs[m] - vs[i]
            area = au * bv - av * bu
            if abs(area) < 1e-12 or (closed and area > 0.0):
                continue
            v0 = max(int(np.ceil(min(vs[i], vs[j], vs[m]))), 0)
            v1 = min(int(np.floor(max(vs[i], vs[j], vs[m]))), h - 1)
            if v0 > v1:
                continue
            u0 = max(int(np.ceil(min(us[i], us[j], us[m]))), 0)
            u1 = min(int(np.floor(max(us[i], us[j], us[m]))), w - 1)
            if u0 > u1:
                continue
            sign = 1.0 / area
            dq1, dq2 = bv * sign, -av * sign
            dw1, dw2 = ws[j] - ws[i], ws[m] - ws[i]
            x = u0 - us[i]
            for v in range(v0, v1 + 1):
                y = v - vs[i]
                q1 = (x * bv - y * bu) * sign
                q2 = (au * y - av * x) * sign
                at = first + v * w + u0
                for _ in range(u0, u1 + 1):
                    if q1 >= 0.0 and q2 >= 0.0 and q1 + q2 <= 1.0:
                        near = ws[i] + q1 * dw1 + q2 * dw2
                        if near > out[at]:
                            out[at] = near
                    q1 += dq1
                    q2 += dq2
                    at += 1
    for i in range(len(out)):
        out[i] = 1.0 / out[i] if out[i] > 0.0 else np.inf


@njit(cache=True)
def compare(drawn, e, out):
    """Compare the rendered depth with the measured depth: write the signed error of each pixel, from -1 to 1,
    to out[:n]. Its square is the pixel's loss.

    The loss of a difference r [scales] is that of Geman and McClure, r^2 / (1 + r^2).
    """
    for i in range(len(e.depth)):
        z, seen, floor = drawn[i], e.depth[i], e.floor[i]
        out[i] = 0.0
        if seen == 0.0:
            continue
        if z < floor:
            r = (seen - z) / e.scale
            if e.kinds[i] == OTHER and r < 0:
                continue
        else:
            r = (seen - floor) / e.scale
            if e.kinds[i] == OTHER or (e.kinds[i] == FREE and abs(r) > _BAND):
                continue
        r = min(max(r, -_FAR), _FAR)
        out[i] = r / np.sqrt(1 + r * r)


@njit(cache=True)
def loss(vertices, faces, closed, R, t, e, drawn, errors):
    """Render the depth of a mesh at the pose (R, t) and return its total loss. Also write the rendered depth
    (n,) [m] and the signed errors (n + SUNK,): of each pixel, and how deep the mesh is below its support.
    """
    draw(vertices, faces, closed, R, t, e, drawn)
    compare(drawn, e, errors)
    low = 0.0
    for i in range(len(vertices)):
        low = min(low, R[2, 0] * vertices[i, 0] + R[2, 1] * vertices[i, 1] + R[2, 2] * vertices[i, 2] + t[2])
    sunk = max(low / e.scale, -_FAR)
    errors[len(e.depth) :] = sunk / np.sqrt(1 + sunk * sunk)
    total = 0.0
    for x in errors:
        total += x * x
    return total


@njit(cache=True)
def losses(vertices, faces, closed, Rs, ts, e):
    """Return the total losses (k,) between the depth evidence and the rendered depth of a mesh at poses Rs
    (k, 3, 3), ts (k, 3).
    """
    drawn, errors = np.empty(len(e.depth)), np.empty(len(e.depth) + SUNK)
    out = np.empty(len(Rs))
    for k in range(len(Rs)):
        out[k] = loss(vertices, faces, closed, Rs[k], ts[k], e, drawn, errors)
    return out


@njit(cache=True)
def _moved(R, t, center, step, out_R, out_t):
    """Apply a step to the pose (R, t) of a rendered mesh: rotate the mesh about its center by step[:3], and
    shift it by step[3:]. Write the new pose to `out_R` and `out_t`.
    """
    x, y, z = step[0], step[1], step[2]
    angle = np.sqrt(x * x + y * y + z * z)
    a = np.sin(angle) / angle if angle > 1e-9 else 1.0
    b = (1 - np.cos(angle)) / angle**2 if angle > 1e-6 else 0.5
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turn = np.eye(3) + a * K + b * (K @ K)
    middle = R @ center + t
    out_R[:] = turn @ R
    out_t[:] = middle + step[3:] - out_R @ center


@njit(cache=True)
def refine(vertices, faces, closed, center, radius, R, t, e, pixel, iterations):
    """Refine the pose (R, t) of a mesh with the Levenberg-Marquardt method, such that its rendered depth has
    the minimum loss.

    The derivatives are differences over about one pixel, so that the silhouette counts, too.

    Args:
        pixel: [m] size of a pixel at the object.
    Returns:
        The pose (R, t) and its loss.
    """
    n = len(e.depth) + SUNK
    drawn, errors, ahead, behind = np.empty(len(e.depth)), np.empty(n), np.empty(n), np.empty(n)
    J = np.empty((6, n))
    R, t = R.copy(), t.copy()
    R2, t2 = np.empty((3, 3)), np.empty(3)
    best = loss(vertices, faces, closed, R, t, e, drawn, errors)
    damping, width = 1e-2, 1.0
    for _ in range(iterations):
        for k in range(6):
            h = width * pixel / (radius if k < 3 else 1.0)
            step = np.zeros(6)
            step[k] = h
            _moved(R, t, center, step, R2, t2)
            loss(vertices, faces, closed, R2, t2, e, drawn, ahead)
            step[k] = -h
            _moved(R, t, center, step, R2, t2)
            loss(vertices, faces, closed, R2, t2, e, drawn, behind)
            for i in range(n):
                J[k, i] = (ahead[i] - behind[i]) / (2 * h)
        A, g = J @ J.T, J @ errors
        better = False
        for _ in range(4):
            D = A.copy()
            for a in range(6):
                D[a, a] += damping * A[a, a] + 1e-9
            step = np.linalg.solve(D, -g)
            far = np.sqrt((step[:3] ** 2).sum())
            if far > 0.3:
                step *= 0.3 / far
            _moved(R, t, center, step, R2, t2)
            new = loss(vertices, faces, closed, R2, t2, e, drawn, ahead)
            if new < best:
                better = best - new > 2e-3 * best
                R[:], t[:], best = R2, t2, new
                errors[:] = ahead
                damping = max(damping / 4, 1e-4)
                break
            damping *= 5
        if not better:
            if width < 0.4:
                break
            width *= 0.5
            damping = min(damping, 1e-1)
    return R, t, best
