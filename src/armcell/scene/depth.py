"""From a depth image to points."""

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
    """The points (n, 3) [m, world frame] of a depth image.

    Args:
        depth: (rows, columns) [m] along the optical axis, or whole numbers in millimetres (ROS's 16UC1);
            what is NaN, infinite or not positive was not seen and is left out.
        intrinsics: K (3, 3) [px], whole numbers at the pixels' centres.
        T_world_camera: of the optical frame: z forward, x right, y down.
        nearest: points nearer or farther than these [m] are left out.
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
