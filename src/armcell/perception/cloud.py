"""Conversion of a depth image to an organized point cloud: one point per pixel."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from armcell.core import InputError, Pinhole

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


def meters(depth: ArrayLike) -> F32:
    """Convert a depth image (h, w) to meters for a point cloud. Missing depth becomes 0.

    Integers are millimeters (ROS's 16UC1).
    """
    image = np.asarray(depth)
    if image.ndim != 2 or image.dtype.kind not in "fiu":
        raise InputError(f"a depth image has rows and columns of numbers, not shape {image.shape}")
    z = image.astype(np.float32) * np.float32(1.0 if image.dtype.kind == "f" else 1e-3)
    return np.where(np.isfinite(z) & (z > 0), z, np.float32(0.0))


def organized_cloud(depth: ArrayLike, pinhole: Pinhole) -> F64:
    """Convert a depth image to an organized point cloud (h, w, 3) [m, camera frame].

    Pixels without depth yield NaN.
    """
    z = meters(depth)
    if z.shape != (pinhole.height, pinhole.width):
        raise InputError(
            f"depth of {z.shape[1]} x {z.shape[0]} pixels for a camera of {pinhole.width} x {pinhole.height}",
            hint="use the camera info of this picture's size",
        )
    return _organized(z, pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy)


@njit(cache=True)
def _organized(z, fx, fy, cx, cy):
    h, w = z.shape
    out = np.empty((h, w, 3))
    for v in range(h):
        y = (v - cy) / fy
        for u in range(w):
            d = float(z[v, u])
            if d > 0:
                out[v, u, 0], out[v, u, 1], out[v, u, 2] = (u - cx) / fx * d, y * d, d
            else:
                out[v, u, :] = np.nan
    return out
