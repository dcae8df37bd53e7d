"""A map of what a camera sees while the cell runs, without the robot, what it holds and known objects."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from armcell.collision import object_mask, robot_mask
from armcell.core import CameraImage, ErrorCode, InputError, Outcome
from armcell.core.checks import checked
from armcell.perception.cloud import organised
from armcell.perception.usable import unusable
from armcell.scene import OCTOMAP, OccupancyMap, PlanningScene, SensorModel, with_octomap


@dataclass(frozen=True)
@checked()
class MapSettings:
    """How a camera's pictures become obstacles. Lengths in metres."""

    resolution: float = 0.02  # edge of a voxel
    max_range: float = 2.5  # what is farther off only says what is free up to there
    robot_padding: float = 0.03  # around the robot and what it holds
    object_padding: float = 0.02  # around objects of the scene, which stay in it as they are
    every: int = 2  # every so many pixels of a row and a column count
    speckle: int = 4  # so many of these pixels must hang together: fewer are a depth camera's noise
    max_age: float = 0.5  # [s] an older picture is stale
    sensor: SensorModel = SensorModel()

    def __post_init__(self) -> None:
        if self.every < 1:
            raise InputError(f"every is {self.every}, it must be 1 or more")
        if self.speckle < 1:
            raise InputError(f"speckle is {self.speckle}, it must be 1 or more", cure="1 keeps every pixel")
        for name in ("robot_padding", "object_padding"):
            if not getattr(self, name) >= 0:
                raise InputError(f"{name} is {getattr(self, name):g}, it must be a number >= 0")


@dataclass(frozen=True)
class MapUpdate(Outcome):
    """What one picture did to a map."""

    hits: int = 0  # points that are obstacles
    robot_points: int = 0
    object_points: int = 0
    cells: int = 0  # of the octree
    cpu_time: float = 0.0  # [s]


class CameraMap:
    """An occupancy map that is fed picture by picture. `map` and `octree` are what is known now."""

    def __init__(self, settings: MapSettings = MapSettings()):
        self.settings = settings
        self.clear()

    def clear(self) -> None:
        self.map = OccupancyMap(self.settings.resolution, self.settings.sensor)
        self.octree = self.map.octree()

    def update(self, image: CameraImage, scene: PlanningScene, now: float | None = None) -> MapUpdate:
        """Put a picture into the map.

        Rays clear what they pass through, also those that end on the robot or on an object of the scene.

        Args:
            scene: the robot as it stood when the picture was taken, what it holds, known objects.
            now: [s] of the picture's clock; an old picture is refused.
        Returns:
            SUCCESS, or why the picture was not used (the map stays as it was).
        """
        started, s = time.thread_time(), self.settings
        trouble = unusable(image, s.max_age, now)
        if trouble is not None:
            return MapUpdate(trouble.code, trouble.message, trouble.evidence, cells=len(self.octree.sizes))
        assert image.depth is not None
        step = slice(s.every // 2, None, s.every)
        grid = organised(image.depth, image.pinhole)[step, step]
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
        """The scene with this map as its octomap."""
        return with_octomap(scene, self.octree if len(self.octree.sizes) else None)


def _without_speckle(mask: NDArray[np.bool_], least: int) -> NDArray[np.bool_]:
    """A picture's mask without the patches (diagonals connect) of fewer than `least` pixels.

    Noise moves single pixels of a known surface out of its padding; an obstacle fills several side by side.
    """
    patches = np.empty(mask.shape, np.int32)
    ndimage.label(mask, np.ones((3, 3)), output=patches)
    return mask & (np.bincount(patches.ravel())[patches] >= least)
