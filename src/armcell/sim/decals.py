"""Decals: images on links, objects, or the world that cameras see and physics ignores."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, InputError, UnknownNameError
from armcell.core.checks import checked
from armcell.scene import WORLD

LIFT = 0.0005  # [m] distance from the surface below, so that the two surfaces do not flicker
VISUAL_GROUP = 2
_REPEAT = 16  # texels per image pixel and axis: graphics drivers blur between texels


@dataclass(frozen=True, eq=False)
@checked()
class Decal:
    """Decal: a square grayscale image (n, n) uint8, such as a marker, that is attached to a frame in the
    simulation.

    The decal is visible from the side that its z axis points to. Its x axis points right and its y axis up in
    the image. `size` [m] is the edge length of the image.
    """

    name: str
    frame: str  # link, object or "world"
    T_frame_decal: SE3
    size: float
    picture: NDArray[np.uint8]

    def __post_init__(self) -> None:
        if not (np.isfinite(self.size) and self.size > 0):
            raise InputError(f"decal {self.name!r} has size {self.size:g} m, it must be positive")
        if self.picture.ndim != 2 or self.picture.shape[0] != self.picture.shape[1]:
            raise InputError(f"decal {self.name!r} needs a square picture of grey")

    def brightness(self, points: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return the brightness (m,), from 0 to 1, of a decal's image at points (m, k) [m, decal frame]. The
        first two columns of the points are x and y.
        """
        n = len(self.picture)
        column = np.clip(np.floor((points[:, 0] / self.size + 0.5) * n), 0, n - 1).astype(int)
        row = np.clip(np.floor((0.5 - points[:, 1] / self.size) * n), 0, n - 1).astype(int)
        return self.picture[row, column].astype(np.float32) / np.float32(255)


def geom_name(decal: Decal) -> str:
    return f"{decal.name}:decal"


def add_decals(spec: mujoco.MjSpec, bodies: dict[str, Any], decals: Iterable[Decal]) -> None:
    """Add decals (flat images such as markers) to the bodies of a MuJoCo spec, as textured meshes.

    Raises:
        UnknownNameError: a decal's frame does not exist.
    """
    for decal in decals:
        body = spec.worldbody if decal.frame == WORLD else bodies.get(decal.frame)
        if body is None:
            raise UnknownNameError("frame", decal.frame, [WORLD, *bodies], element=f"decal {decal.name}")
        grey = np.repeat(np.repeat(decal.picture, _REPEAT, 0), _REPEAT, 1)
        texture = spec.add_texture(
            name=geom_name(decal), type=mujoco.mjtTexture.mjTEXTURE_2D, width=grey.shape[1],
            height=grey.shape[0], nchannel=3,
        )  # fmt: skip
        texture.data = np.repeat(grey[:, :, None], 3, 2).tobytes()
        material = spec.add_material(name=geom_name(decal), specular=0.0, shininess=0.0)
        textures = list(material.textures)
        textures[int(mujoco.mjtTextureRole.mjTEXROLE_RGB)] = geom_name(decal)
        material.textures = textures
        h = decal.size / 2
        spec.add_mesh(
            name=geom_name(decal),
            uservert=[-h, -h, 0, h, -h, 0, h, h, 0, -h, h, 0],
            userface=[0, 1, 2, 0, 2, 3],
            usertexcoord=[0, 1, 1, 1, 1, 0, 0, 0],  # MuJoCo counts texture rows from the top
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
        T = decal.T_frame_decal @ SE3.from_xyz(0, 0, LIFT)
        body.add_geom(
            name=geom_name(decal), type=mujoco.mjtGeom.mjGEOM_MESH, meshname=geom_name(decal),
            material=geom_name(decal), pos=T.translation, quat=T.quat_wxyz, contype=0, conaffinity=0,
            group=VISUAL_GROUP, density=0.0, rgba=[1, 1, 1, 1],
        )  # fmt: skip
