"""Conversion of a depth image to an organized point cloud: one point per pixel."""

from __future__ import annotations

import numpy as np
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
    z = np.where(z > 0, z, np.nan)
    out = np.empty((*z.shape, 3))
    out[..., 0] = (np.arange(pinhole.width) - pinhole.cx) / pinhole.fx * z
    out[..., 1] = ((np.arange(pinhole.height) - pinhole.cy) / pinhole.fy)[:, None] * z
    out[..., 2] = z
    return out
