"""Occupancy map from camera images during a run, without the robot and known objects."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armcell.collision import object_mask, robot_mask
from armcell.core import CameraImage, ErrorCode, InputError, Outcome
from armcell.core.checks import checked
from armcell.perception.cloud import organized_cloud
from armcell.perception.image_checks import check_image
from armcell.scene import OCTOMAP, OccupancyMap, PlanningScene, SensorModel, with_octomap


@dataclass(frozen=True)
@checked()
class MapSettings:
    """Settings for an occupancy map from camera images; lengths in meters."""

    resolution: float = 0.02  # edge length of a voxel
    max_range: float = 2.5  # farther points only mark free space up to this range
    robot_padding: float = 0.03  # margin around the robot and held objects
    object_padding: float = 0.02  # margin around objects of the scene, which stay in the scene
    every: int = 2  # pixel step in rows and columns
    speckle: int = 4  # minimum number of connected pixels; fewer are noise
    max_age: float = 0.5  # [s] older images are stale
    sensor: SensorModel = SensorModel()

    def __post_init__(self) -> None:
        if self.every < 1:
            raise InputError(f"every is {self.every}, it must be 1 or more")
        if self.speckle < 1:
            raise InputError(f"speckle is {self.speckle}, it must be 1 or more", hint="1 keeps every pixel")
        for name in ("robot_padding", "object_padding"):
            if not getattr(self, name) >= 0:
                raise InputError(f"{name} is {getattr(self, name):g}, it must be a number >= 0")


@dataclass(frozen=True)
class MapUpdate(Outcome):
    """Result of adding one camera image or point cloud to an occupancy map."""

    hits: int = 0  # number of obstacle points
    robot_points: int = 0
    object_points: int = 0
    cells: int = 0  # number of octree cells
    cpu_time: float = 0.0  # [s]


class CameraMap:
    """Occupancy map that is updated with camera images, one after the other.

    `map` and `octree` contain the current state.
    """

    def __init__(self, settings: MapSettings = MapSettings()):
        self.settings = settings
        self.clear()

    def clear(self) -> None:
        self.map = OccupancyMap(self.settings.resolution, self.settings.sensor)
        self.octree = self.map.octree()

    def update(self, image: CameraImage, scene: PlanningScene, now: float | None = None) -> MapUpdate:
        """Add one camera image to the occupancy map.

        Rays mark the cells they pass as free, also rays that end on the robot or on an object of the scene.

        Args:
            scene: the robot's state at the time of the image, held objects, known objects.
            now: [s] of the image's clock; an old image is rejected.
        Returns:
            SUCCESS, or why the image was not used (the map stays unchanged).
        """
        started, s = time.thread_time(), self.settings
        trouble = check_image(image, s.max_age, now)
        if trouble is not None:
            return MapUpdate(trouble.code, trouble.message, trouble.evidence, cells=len(self.octree.sizes))
        assert image.depth is not None
        step = slice(s.every // 2, None, s.every)
        grid = organized_cloud(image.depth, image.pinhole)[step, step]
        seen = np.isfinite(grid[..., 0])
        points = image.T_world_camera.apply(grid[seen])
        robot = robot_mask(scene, points, s.robot_padding)
        solid = [n for n, o in scene.objects.items() if n != OCTOMAP and not o.has_cloud]
        known = object_mask(scene, points, s.object_padding, solid) & ~robot
        eye = image.T_world_camera.translation
        unknown = np.zeros(seen.shape, bool)
        unknown[seen] = ~robot & ~known
        hits = points[_without_speckle(unknown, s.speckle)[seen]]
        self.map = self.map.updated(hits, eye, s.max_range, points[robot | known])
        self.octree = self.map.octree()
        return MapUpdate(
            ErrorCode.SUCCESS, "", {}, hits=len(hits), robot_points=int(robot.sum()),
            object_points=int(known.sum()), cells=len(self.octree.sizes),
            cpu_time=time.thread_time() - started,
        )  # fmt: skip

    def applied_to(self, scene: PlanningScene) -> PlanningScene:
        """Return a copy of the planning scene whose octomap is replaced with this occupancy map from camera
        images.
        """
        return with_octomap(scene, self.octree if len(self.octree.sizes) else None)


def _without_speckle(mask: NDArray[np.bool_], least: int) -> NDArray[np.bool_]:
    """Return a mask of camera pixels for the occupancy map, without patches of fewer than `least` connected
    pixels.

    Pixels are 8-connected.

    Noise moves single pixels of a known surface out of its margin; an obstacle covers several adjacent
    pixels.
    """
    from scipy.ndimage import label  # imported late: every cell imports this module, and few build maps

    patches = np.empty(mask.shape, np.int32)
    label(mask, np.ones((3, 3)), output=patches)
    return mask & (np.bincount(patches.ravel())[patches] >= least)
