"""Winding numbers, which decide whether points are inside or outside a mesh."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True)
def winding_numbers(points, vertices, faces):
    """Compute the generalized winding number (m,) of points with respect to a mesh: 1 inside a closed mesh, 0
    outside.

    The number is robust to holes. It sums Van Oosterom and Strackee's solid angle (1983) over the triangles
    (Jacobson et al. 2013).
    """
    out = np.empty(len(points))
    for p in range(len(points)):
        total = 0.0
        for f in range(len(faces)):
            ax = vertices[faces[f, 0], 0] - points[p, 0]
            ay = vertices[faces[f, 0], 1] - points[p, 1]
            az = vertices[faces[f, 0], 2] - points[p, 2]
            bx = vertices[faces[f, 1], 0] - points[p, 0]
            by = vertices[faces[f, 1], 1] - points[p, 1]
            bz = vertices[faces[f, 1], 2] - points[p, 2]
            cx = vertices[faces[f, 2], 0] - points[p, 0]
            cy = vertices[faces[f, 2], 1] - points[p, 1]
            cz = vertices[faces[f, 2], 2] - points[p, 2]
            la = np.sqrt(ax * ax + ay * ay + az * az)
            lb = np.sqrt(bx * bx + by * by + bz * bz)
            lc = np.sqrt(cx * cx + cy * cy + cz * cz)
            det = ax * (by * cz - bz * cy) - ay * (bx * cz - bz * cx) + az * (bx * cy - by * cx)
            dot_ab = ax * bx + ay * by + az * bz
            dot_bc = bx * cx + by * cy + bz * cz
            dot_ca = cx * ax + cy * ay + cz * az
            total += np.arctan2(det, la * lb * lc + dot_ab * lc + dot_bc * la + dot_ca * lb)
        out[p] = total / (2.0 * np.pi)
    return out
