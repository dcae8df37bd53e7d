"""Construction of simulated cameras and markers from the entries of a cell file."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from armcell.cell.schema import CameraSpec, MarkerSpec, NoiseSpec
from armcell.core import SE3, Pinhole, UnknownNameError
from armcell.kinematics import kinematic_tree
from armcell.model import RobotModel
from armcell.model.assets import resolve_uri
from armcell.perception import load_camera_info, marker_picture, picture_size
from armcell.scene import WORLD, PlanningScene
from armcell.sim import Camera, Decal, DepthNoise, look_at


def camera_of(name: str, spec: CameraSpec, model: RobotModel, positions: ArrayLike, folder: Path) -> Camera:
    """Create the simulated camera that an entry in the cell file describes.

    Args:
        positions: (dof,) joint positions; they set the pose of a camera that is mounted on a link.
        folder: folder of the cell file, for relative file names.
    Raises:
        UnknownNameError: the link does not exist.
        InputError: the values are not valid for a camera, or a file is broken.
    """
    if spec.eye is not None and spec.target is not None:
        T = look_at(spec.eye, spec.target)
    else:
        T = SE3.from_mapping(spec.pose, "pose")
    mount = None
    if spec.on is not None:
        model.link(spec.on)
        mount, T = T, kinematic_tree(model).link_pose(positions, spec.on) @ T
    return Camera(
        name, T, spec.width, spec.height, spec.fovy_deg, pinhole_of(spec, folder), spec.on, mount, spec.rate,
        spec.depth, noise_of(spec.noise),
    )  # fmt: skip


def pinhole_of(spec: CameraSpec, folder: Path) -> Pinhole | None:
    """Return the camera intrinsics that an entry in the cell file gives explicitly, or None if it gives none.

    Without explicit intrinsics, the image size and the field of view define the camera.
    """
    if spec.info is not None:
        return load_camera_info(resolve_uri(spec.info, folder)).rectified()
    if spec.intrinsics is not None:
        i = spec.intrinsics
        return Pinhole(spec.width, spec.height, i.fx, i.fy, i.cx, i.cy)
    return None


def noise_of(spec: str | NoiseSpec) -> DepthNoise:
    if isinstance(spec, NoiseSpec):
        return DepthNoise(**spec.model_dump())
    return DepthNoise.for_stereo() if spec == "stereo" else DepthNoise()


def decal_of(name: str, spec: MarkerSpec, known: Iterable[str]) -> Decal:
    """Return the textured square (decal) that makes a marker of the cell file visible to the cell's simulated
    cameras.

    Raises:
        UnknownNameError: the frame or the marker family does not exist.
        MissingExtraError: OpenCV is not installed.
    """
    frames = [WORLD, *known]
    if spec.on not in frames:
        raise UnknownNameError("frame", spec.on, frames)
    picture = marker_picture(spec.family, spec.id)
    size = picture_size(spec.family, spec.size)
    return Decal(name, spec.on, SE3.from_mapping(spec.pose, "pose"), size, picture)


def in_view(camera: Camera, scene: PlanningScene) -> list[str]:
    """Return the objects whose center is in the image from a cell's camera. Occlusion is ignored."""
    found = []
    for name, item in scene.objects.items():
        low, high = item.bounds()
        middle = item.T_world_object.apply((low + high) / 2)
        pixel = camera.model.project(camera.T_world_camera.inverse().apply(middle))[0]
        if np.all((pixel >= 0) & (pixel <= [camera.width - 1, camera.height - 1])):
            found.append(name)
    return found
