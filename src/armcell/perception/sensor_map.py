"""An octomap from point clouds of several sensors, without the robot and known objects."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.collision import object_mask, robot_mask
from armcell.core import SE3, ErrorCode
from armcell.perception.camera_map import MapUpdate
from armcell.perception.sensors_3d import RESOLUTION, Sensor3d
from armcell.scene import OCTOMAP, OccupancyMap, PlanningScene, with_octomap


class SensorMap:
    """Occupancy map that is updated with point clouds from several sensors, like that of move_group.

    `map` and `octree` contain the current state.
    """

    def __init__(self, resolution: float = RESOLUTION):
        self.resolution = resolution
        self.clear()

    def clear(self) -> None:
        self.map = OccupancyMap(self.resolution)
        self.octree = self.map.octree()

    def update(
        self, points: ArrayLike, T_world_sensor: SE3, scene: PlanningScene, sensor: Sensor3d
    ) -> tuple[MapUpdate, NDArray[np.float64]]:
        """Add the point cloud of one sensor to the occupancy map (octomap).

        Rays mark the cells they pass as free, also rays that end on the robot, a held object or an object of
        the scene. Cells that no ray reaches stay unknown, which counts as free.

        Args:
            points: (n, 3) [m, sensor frame]; NaN for missing points.
            scene: the robot's state at the time of the cloud.
        Returns:
            The result, and the points that are obstacles (m, 3) [m, sensor frame].
        Raises:
            InputError: the cloud is too large for the map.
        """
        started = time.thread_time()
        seen = np.asarray(points, float).reshape(-1, 3)[:: sensor.point_subsample]
        seen = seen[np.isfinite(seen).all(axis=1)]
        world = T_world_sensor.apply(seen)
        robot = robot_mask(scene, world, sensor.padding_offset, scale=sensor.padding_scale)
        solid = [n for n, o in scene.objects.items() if n != OCTOMAP and not o.has_cloud]
        known = object_mask(scene, world, max(sensor.padding_offset, self.resolution), solid) & ~robot
        free = robot | known
        self.map = self.map.updated(world[~free], T_world_sensor.translation, sensor.max_range, world[free])
        self.octree = self.map.octree()
        done = MapUpdate(
            ErrorCode.SUCCESS, "", {}, hits=int(np.sum(~free)), robot_points=int(robot.sum()),
            object_points=int(known.sum()), cells=len(self.octree.sizes),
            cpu_time=time.thread_time() - started,
        )  # fmt: skip
        return done, seen[~free]

    def applied_to(self, scene: PlanningScene) -> PlanningScene:
        """Return the planning scene with this occupancy map as its octomap. The octomap replaces the old one.

        If the map has no occupied cells, the returned scene has no octomap.
        """
        return with_octomap(scene, self.octree if len(self.octree.sizes) else None)
