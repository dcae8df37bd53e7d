"""The camera model: where it is and how its pixels look out."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core import SE3, SO3, InputError


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera. Its frame is optical: z forward, x right, y down. Square pixels, centred."""

    name: str
    T_world_camera: SE3
    width: int = 640  # [px]
    height: int = 480  # [px]
    fovy_deg: float = 45.0  # vertical field of view

    def __post_init__(self) -> None:
        if not (1 <= self.width <= 8192 and 1 <= self.height <= 8192):
            raise InputError(f"camera {self.name!r} has {self.width} x {self.height} pixels")
        if not 1.0 <= self.fovy_deg <= 170.0:
            raise InputError(
                f"camera {self.name!r} has a field of view of {self.fovy_deg} deg", cure="use 1 to 170"
            )

    @staticmethod
    def looking_at(name: str, eye: ArrayLike, target: ArrayLike, **properties) -> Camera:
        """A camera at `eye` (3,) that looks at `target` (3,) [m, world frame], world z up in the picture."""
        eye, target = np.asarray(eye, float), np.asarray(target, float)
        z = (target - eye) / np.linalg.norm(target - eye)
        up = np.array([0.0, 0.0, 1.0]) if abs(z[2]) < 0.999 else np.array([1.0, 0.0, 0.0])
        x = np.cross(z, up)
        x /= np.linalg.norm(x)
        R = np.stack([x, np.cross(z, x), z], axis=1)
        return Camera(name, SE3(SO3(R), eye), **properties)

    def at(self, T_world_camera: SE3) -> Camera:
        return replace(self, T_world_camera=T_world_camera)

    @property
    def focal(self) -> float:
        """[px], the same for both axes."""
        return self.height / 2 / np.tan(np.deg2rad(self.fovy_deg) / 2)

    @property
    def intrinsics(self) -> NDArray[np.float64]:
        """K (3, 3) [px] of pixels with whole numbers at their centres."""
        f = self.focal
        return np.array([[f, 0, (self.width - 1) / 2], [0, f, (self.height - 1) / 2], [0, 0, 1.0]])
