"""Camera intrinsics, images with depth, pose and time, and height maps of scenes seen from above."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core.checks import checked, float_array
from armcell.core.errors import InputError
from armcell.core.transforms import SE3

Array = NDArray[np.float64]
MAX_PIXELS = 8192
"""Maximum width and height of a camera image [px]."""


@dataclass(frozen=True)
@checked()
class Pinhole:
    """Pinhole camera with which an image was taken: its intrinsics. Pixel centers have integer coordinates; x
    points right, y down.

    `distortion` is "plumb_bob" as in ROS and OpenCV: k1, k2, p1, p2, k3; empty for a rectified image.
    """

    width: int  # [px]
    height: int  # [px]
    fx: float  # [px]
    fy: float  # [px]
    cx: float  # [px]
    cy: float  # [px]
    distortion: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if not (1 <= self.width <= MAX_PIXELS and 1 <= self.height <= MAX_PIXELS):
            raise InputError(f"a camera has {self.width} x {self.height} pixels", hint="1 to 8192 each")
        for name in ("fx", "fy"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise InputError(f"focal length {name} is {getattr(self, name):g} px, it must be positive")
        if not np.all(np.isfinite([self.cx, self.cy, *self.distortion])):
            raise InputError("a camera's principal point and distortion need finite numbers")
        if len(self.distortion) not in (0, 4, 5):
            raise InputError(
                f"a camera has {len(self.distortion)} distortion coefficients",
                hint="none, or plumb_bob's k1, k2, p1, p2, k3",
            )

    @staticmethod
    def of_fov(width: int, height: int, fovy_deg: float) -> Pinhole:
        """Create the intrinsics of a camera image with square pixels from the camera's vertical field of view
        [deg].

        The principal point is the center of the image.
        """
        if not 1.0 <= fovy_deg <= 170.0:
            raise InputError(f"a camera has a field of view of {fovy_deg} deg", hint="use 1 to 170")
        f = height / 2 / float(np.tan(np.deg2rad(fovy_deg) / 2))
        return Pinhole(width, height, f, f, (width - 1) / 2, (height - 1) / 2)

    @property
    def matrix(self) -> Array:
        """Return the camera matrix K (3, 3) [px] with which points are projected to an image."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1.0]])

    @property
    def fovy_deg(self) -> float:
        """Return the vertical field of view [deg] of a camera image whose principal point is at its
        center.
        """
        return float(np.rad2deg(2 * np.arctan(self.height / 2 / self.fy)))

    def project(self, points: ArrayLike) -> Array:
        """Project points (n, 3) [m, camera frame] to pixel coordinates (n, 2) of a camera image, without lens
        distortion.

        Points behind the camera yield NaN.
        """
        p = float_array(points, (-1, 3), "points", finite=False).reshape(-1, 3)
        z = np.where(p[:, 2] > 0, p[:, 2], np.nan)
        return np.column_stack([p[:, 0] / z * self.fx + self.cx, p[:, 1] / z * self.fy + self.cy])


@dataclass(frozen=True, eq=False)
@checked()
class CameraImage:
    """Camera image with color (h, w, 3) uint8, depth (h, w) [m] along the optical axis, or both.

    Pixels without depth are 0 (NaN and negative numbers mean the same). The camera frame is optical: z
    forward, x right, y down.
    """

    camera: str
    pinhole: Pinhole
    T_world_camera: SE3
    time: float = 0.0  # [s] of the cell's clock
    rgb: NDArray[np.uint8] | None = None
    depth: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        size = (self.pinhole.height, self.pinhole.width)
        if self.rgb is not None and self.rgb.shape != (*size, 3):
            raise InputError(
                f"the picture of camera {self.camera!r} is of shape {self.rgb.shape}, not {(*size, 3)}",
                hint="use the camera info of this picture's size",
            )
        if self.depth is not None and self.depth.shape != size:
            raise InputError(
                f"the depth of camera {self.camera!r} is of shape {self.depth.shape}, not {size}",
                hint="use the camera info of this picture's size",
            )


@dataclass(frozen=True, eq=False)
@checked()
class HeightMap:
    """Image whose pixels are heights [m, world z] (height map): a grid over a rectangle of the world, as a
    camera sees it from above.

    Unseen cells have the height of the highest seen neighbor, because hidden objects may be there.
    """

    heights: NDArray[np.float64]  # (nx, ny) [m, world z]
    seen: NDArray[np.bool_]  # (nx, ny)
    origin: tuple[float, float]  # [m, world] center of the first cell
    resolution: float  # [m]

    def at(self, cells: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the pixels at given indices of an image of heights as points (n, 3) [m, world frame], each
        at the height of its pixel.
        """
        cells = float_array(cells, (None, 2), "cells").astype(np.int64)
        if ((cells < 0) | (cells >= self.heights.shape)).any():
            raise InputError(f"a cell is outside a map of {self.heights.shape} cells")
        found = np.empty((len(cells), 3))
        found[:, :2] = np.asarray(self.origin) + self.resolution * cells
        found[:, 2] = self.heights[cells[:, 0], cells[:, 1]]
        return found

    def cells_within(self, low: ArrayLike, high: ArrayLike) -> NDArray[np.bool_]:
        """Return which pixels of an image of heights have their centers inside a rectangle [m, world frame],
        as a mask (nx, ny).
        """
        low, high = float_array(low, (2,), "low"), float_array(high, (2,), "high")
        nx, ny = self.heights.shape
        x = self.origin[0] + self.resolution * np.arange(nx)
        y = self.origin[1] + self.resolution * np.arange(ny)
        inside_x, inside_y = (x >= low[0]) & (x <= high[0]), (y >= low[1]) & (y <= high[1])
        return inside_x[:, None] & inside_y[None, :]
