"""Conversion of a camera's depth images into 3D points."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core import SE3, InputError
from armcell.core.checks import float_array

Array = NDArray[np.float64]


def depth_points(
    depth: ArrayLike,
    intrinsics: ArrayLike,
    T_world_camera: SE3 = SE3.identity(),
    nearest: float = 0.0,
    farthest: float = np.inf,
) -> Array:
    """Convert the depth image of a camera to points (n, 3) [m, world frame].

    Args:
        depth: (rows, columns) distances along the optical axis, either floats [m] or integers [mm] (ROS's
            16UC1 encoding). Pixels that are NaN, infinite or not positive are left out.
        intrinsics: camera matrix K (3, 3) [px]; integer coordinates are pixel centers.
        T_world_camera: pose of the optical frame (z forward, x right, y down).
        nearest, farthest: points outside this range of depths [m] are left out.
    Raises:
        InputError: `depth` is not a 2D array of numbers, or `intrinsics` is not a valid camera matrix.
    """
    float_array(depth, None, "a depth image", finite=False)
    image, K = np.asarray(depth), float_array(intrinsics, (3, 3), "intrinsics")
    if image.ndim != 2 or image.dtype.kind not in "fiu":
        raise InputError(f"a depth image has rows and columns of numbers, not shape {image.shape}")
    if K.shape != (3, 3) or not np.all(np.isfinite(K)) or K[0, 0] <= 0 or K[1, 1] <= 0:
        raise InputError("intrinsics need a (3, 3) matrix with positive focal lengths")
    z = image.astype(float) * (1.0 if image.dtype.kind == "f" else 1e-3)
    with np.errstate(invalid="ignore"):
        seen = np.isfinite(z) & (z > 0) & (z >= nearest) & (z <= farthest)
    v, u = np.nonzero(seen)
    z = z[seen]
    x, y = (u - K[0, 2]) * z / K[0, 0], (v - K[1, 2]) * z / K[1, 1]
    return T_world_camera.apply(np.column_stack([x, y, z]))
