"""Model of a simulated camera: pose, intrinsics, frame rate, and depth noise."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core import SE3, SO3, InputError, Pinhole
from armcell.core.checks import checked, float_array


@dataclass(frozen=True)
@checked()
class DepthNoise:
    """Noise in the depth images of a simulated camera. With all values at zero, the images have no noise.

    Stereo and structured-light cameras measure disparity, so their noise and depth resolution grow with the
    square of the distance (Khoshelham and Elberink, Sensors 12(2), 2012). `for_stereo` approximates an Intel
    D435 at 640 x 480 px.
    """

    floor: float = 0.0  # [m] standard deviation at any distance
    growth: float = 0.0  # [1/m] standard deviation per distance squared
    step: float = 0.0  # [m] depth resolution at any distance
    step_growth: float = 0.0  # [1/m] depth resolution per distance squared
    dropout: float = 0.0  # fraction of pixels without a depth value
    edge_dropout: float = 0.0  # fraction of pixels without a depth value next to a depth discontinuity
    nearest: float = 0.0  # [m] smallest distance that the camera measures
    farthest: float = np.inf  # [m] largest distance that the camera measures

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            if np.isnan(value) or value < 0:
                raise InputError(f"depth noise has {each.name} {value:g}, it must be a number >= 0")
            if each.name.endswith("dropout") and value > 1:
                raise InputError(f"depth noise has {each.name} {value:g}, it is a share of 0 to 1")
        if self.nearest >= self.farthest:
            raise InputError("depth noise has nearest >= farthest, so nothing would be seen")

    @staticmethod
    def for_stereo() -> DepthNoise:
        return DepthNoise(0.0005, 0.0015, 0.001, 0.0, 0.01, 0.3, 0.2, 4.0)

    @property
    def is_none(self) -> bool:
        return self == DepthNoise()

    def applied(self, depth: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.float32]:
        """Add noise to the depth image (h, w) [m] of a simulated camera and return it. Pixels without a
        measurement are 0.
        """
        z = depth.astype(float)
        seen = (z > 0) & (z >= self.nearest) & (z <= self.farthest)
        noisy = z + rng.standard_normal(z.shape) * (self.floor + self.growth * z**2)
        step = self.step + self.step_growth * z**2
        if self.step > 0 or self.step_growth > 0:
            with np.errstate(divide="ignore", invalid="ignore"):
                noisy = np.where(step > 0, np.round(noisy / step) * step, noisy)
        chance = np.full(z.shape, self.dropout)
        if self.edge_dropout > 0:
            chance = np.where(_edges(z), np.maximum(chance, self.edge_dropout), chance)
        seen &= rng.random(z.shape) >= chance
        return np.where(seen & (noisy > 0), noisy, 0.0).astype(np.float32)


def _edges(z: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return a mask of the pixels next to a jump in the depth image of a simulated camera. A jump is more
    than 3 % of the depth and 1 cm.
    """
    jump = np.zeros(z.shape, bool)
    for axis in (0, 1):
        near, far = (slice(None), slice(1, None)), (slice(None), slice(None, -1))
        if axis == 0:
            near, far = near[::-1], far[::-1]
        apart = np.abs(z[near] - z[far]) > np.maximum(0.03 * np.minimum(z[near], z[far]), 0.01)
        jump[near] |= apart
        jump[far] |= apart
    return jump


@dataclass(frozen=True, eq=False)
@checked()
class Camera:
    """Simulated pinhole camera. Its optical frame has z forward, x to the right and y down.

    Without `pinhole`, pixels are square and the principal point is the image center. For a camera on a link,
    `T_link_camera` is its pose in the link's frame, and `T_world_camera` is its pose at the start.
    """

    name: str
    T_world_camera: SE3
    width: int = 640  # [px]
    height: int = 480  # [px]
    fovy_deg: float = 45.0  # vertical field of view
    pinhole: Pinhole | None = None  # intrinsics that replace width, height and fovy_deg
    link: str | None = None
    T_link_camera: SE3 | None = None
    rate: float = 30.0  # [Hz]
    has_depth: bool = True
    noise: DepthNoise = DepthNoise()
    model: Pinhole = field(init=False)  # the intrinsics

    def __post_init__(self) -> None:
        if self.pinhole is not None:
            if self.pinhole.distortion:
                raise InputError(
                    f"camera {self.name!r} has distortion: simulated pictures are rectified",
                    hint="leave the distortion out",
                )
            for name in ("width", "height", "fovy_deg"):
                object.__setattr__(self, name, getattr(self.pinhole, name))
        try:
            object.__setattr__(self, "model", self.pinhole or self._centerd())
        except InputError as error:
            raise InputError(f"camera {self.name!r}: {error.reason}", hint=error.hint) from None
        if (self.link is None) != (self.T_link_camera is None):
            raise InputError(f"camera {self.name!r}: link and T_link_camera belong together")
        if not (np.isfinite(self.rate) and self.rate > 0):
            raise InputError(f"camera {self.name!r} has a rate of {self.rate:g} Hz, it must be positive")

    @staticmethod
    def looking_at(name: str, eye: ArrayLike, target: ArrayLike, **properties) -> Camera:
        """Create a simulated camera that is at `eye` (3,) and looks at `target` (3,) [m, world frame].

        World z points up in the image.
        """
        return Camera(name, look_at(eye, target), **properties)

    def at(self, T_world_camera: SE3) -> Camera:
        return replace(self, T_world_camera=T_world_camera)

    def _centerd(self) -> Pinhole:
        return Pinhole.of_fov(self.width, self.height, self.fovy_deg)

    @property
    def intrinsics(self) -> NDArray[np.float64]:
        """Return the camera matrix K (3, 3) [px] of a simulated camera. Pixel centers have integer
        coordinates.
        """
        return self.model.matrix


def look_at(eye: ArrayLike, target: ArrayLike) -> SE3:
    """Return the pose of the optical frame of a simulated camera that is at `eye` (3,) and looks at `target`
    (3,).

    The z axis of the frame in which both points are given points up in the image.

    Raises:
        InputError: both points are the same.
    """
    eye, target = float_array(eye, (3,), "eye"), float_array(target, (3,), "target")
    away = np.linalg.norm(target - eye)
    if not away > 1e-9:
        raise InputError("a camera's eye and target are the same point")
    z = (target - eye) / away
    up = np.array([0.0, 0.0, 1.0]) if abs(z[2]) < 0.999 else np.array([1.0, 0.0, 0.0])
    x = np.cross(z, up)
    x /= np.linalg.norm(x)
    return SE3(SO3(np.stack([x, np.cross(z, x), z], axis=1)), eye)
