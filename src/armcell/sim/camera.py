"""The camera model: where it is, how its pixels look out, how often, and how well it measures depth."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core import SE3, SO3, InputError, Pinhole
from armcell.core.checks import checked, float_array


@dataclass(frozen=True)
@checked()
class DepthNoise:
    """What a real depth camera does to the truth. All zero: a perfect one.

    Stereo and structured light measure disparity, so that noise and steps grow with distance squared
    (Khoshelham and Elberink, Sensors 12(2), 2012); `for_stereo` is about an Intel D435 at 640 x 480.
    """

    floor: float = 0.0  # [m] standard deviation at any distance
    growth: float = 0.0  # [1/m] standard deviation per distance squared
    step: float = 0.0  # [m] between the depths that can be told apart
    step_growth: float = 0.0  # [1/m] the same, per distance squared
    dropout: float = 0.0  # share of pixels without a depth
    edge_dropout: float = 0.0  # share of the pixels beside a jump in depth without one
    nearest: float = 0.0  # [m] nothing nearer is measured
    farthest: float = np.inf  # [m] and nothing farther

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
        """Depth (h, w) [m] as the camera would measure it; 0 where it sees nothing."""
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
    """Pixels beside a jump of depth, by more than a slope could explain (3 %, at least 1 cm)."""
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
    """A pinhole camera. Its frame is optical: z forward, x right, y down.

    Pixels are square and centred by the field of view, unless `pinhole` says otherwise. A camera on a link
    has its pose in that link's frame in `T_link_camera`; `T_world_camera` is where that is at the start.
    """

    name: str
    T_world_camera: SE3
    width: int = 640  # [px]
    height: int = 480  # [px]
    fovy_deg: float = 45.0  # vertical field of view
    pinhole: Pinhole | None = None  # instead of width, height and fovy_deg
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
                    cure="leave the distortion out",
                )
            for name in ("width", "height", "fovy_deg"):
                object.__setattr__(self, name, getattr(self.pinhole, name))
        try:
            object.__setattr__(self, "model", self.pinhole or self._centred())
        except InputError as error:
            raise InputError(f"camera {self.name!r}: {error.reason}", cure=error.cure) from None
        if (self.link is None) != (self.T_link_camera is None):
            raise InputError(f"camera {self.name!r}: link and T_link_camera belong together")
        if not (np.isfinite(self.rate) and self.rate > 0):
            raise InputError(f"camera {self.name!r} has a rate of {self.rate:g} Hz, it must be positive")

    @staticmethod
    def looking_at(name: str, eye: ArrayLike, target: ArrayLike, **properties) -> Camera:
        """A camera at `eye` (3,) that looks at `target` (3,) [m, world frame], world z up in the picture."""
        return Camera(name, look_at(eye, target), **properties)

    def at(self, T_world_camera: SE3) -> Camera:
        return replace(self, T_world_camera=T_world_camera)

    def _centred(self) -> Pinhole:
        return Pinhole.of_fov(self.width, self.height, self.fovy_deg)

    @property
    def intrinsics(self) -> NDArray[np.float64]:
        """K (3, 3) [px] of pixels with whole numbers at their centres."""
        return self.model.matrix


def look_at(eye: ArrayLike, target: ArrayLike) -> SE3:
    """The optical frame at `eye` (3,) that looks at `target` (3,), the frame's z axis up in the picture."""
    eye, target = float_array(eye, (3,), "eye"), float_array(target, (3,), "target")
    away = np.linalg.norm(target - eye)
    if not away > 1e-9:
        raise InputError("a camera's eye and target are the same point")
    z = (target - eye) / away
    up = np.array([0.0, 0.0, 1.0]) if abs(z[2]) < 0.999 else np.array([1.0, 0.0, 0.0])
    x = np.cross(z, up)
    x /= np.linalg.norm(x)
    return SE3(SO3(np.stack([x, np.cross(z, x), z], axis=1)), eye)
