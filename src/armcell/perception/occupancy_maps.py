"""Occupancy maps (octomaps) from cameras and from several 3D sensors, and MoveIt's sensors_3d.yaml.

The maps omit the robot and known objects. Source of the keys and defaults of sensors_3d.yaml:
moveit_ros_perception's PointCloudOctomapUpdater and DepthImageOctomapUpdater.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.collision import object_mask, robot_mask
from armcell.core import SE3, CameraImage, ErrorCode, InputError, Outcome, UnknownNameError
from armcell.core.checks import checked, settings_from
from armcell.model.untrusted_files import read_yaml
from armcell.perception.cloud import organized_cloud
from armcell.perception.image_checks import check_image
from armcell.scene import OCTOMAP, OccupancyMap, PlanningScene, SensorModel, with_octomap

RESOLUTION = 0.05  # [m] default of the file's value


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


@dataclass(frozen=True, repr=False)
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


CLOUD, DEPTH = "PointCloudOctomapUpdater", "DepthImageOctomapUpdater"


@dataclass(frozen=True)
@checked()
class Sensor3d:
    """One octomap updater, as configured in sensors_3d.yaml; lengths in meters."""

    point_cloud_topic: str = ""  # sensor_msgs/PointCloud2
    image_topic: str = ""  # sensor_msgs/Image with depth; default camera_info in its namespace
    camera_info_topic: str = ""  # default: <image_topic's namespace>/camera_info
    max_range: float = float("inf")  # farther points only mark free space up to this range
    point_subsample: int = 1  # use every n-th point
    skip_vertical_pixels: int = 0  # ignored pixels at each edge of a depth image
    skip_horizontal_pixels: int = 0
    near_clipping_plane_distance: float = 0.0
    far_clipping_plane_distance: float = float("inf")
    padding_offset: float = 0.0  # margin around the robot, held and known objects
    padding_scale: float = 1.0  # scale of the robot's links
    max_update_rate: float = 0.0  # [Hz] 0: every message
    filtered_cloud_topic: str = ""  # publishes the filtered points of each message
    queue_size: int = 5
    shadow_threshold: float = 0.0  # accepted but unused, because rays clear shadows

    def __post_init__(self) -> None:
        if bool(self.point_cloud_topic) == bool(self.image_topic):
            raise InputError("needs a point_cloud_topic or an image_topic")
        for name, least in {"point_subsample": 1, "padding_offset": 0, "max_update_rate": 0}.items():
            if not getattr(self, name) >= least:
                raise InputError(f"{name} is {getattr(self, name):g}, it must be {least} or more")
        if not (self.max_range > 0 and self.padding_scale > 0):
            raise InputError("max_range and padding_scale must be positive")

    @property
    def topic(self) -> str:
        return self.point_cloud_topic or self.image_topic

    @property
    def info_topic(self) -> str:
        return self.camera_info_topic or f"{self.image_topic.rpartition('/')[0]}/camera_info"


@dataclass(frozen=True)
class Sensors3d:
    """Contents of MoveIt's sensors_3d.yaml: the updaters of one octomap.

    Attributes:
        frame: the octomap's frame; must be fixed in the world, in which clouds are mapped.
    """

    sensors: tuple[Sensor3d, ...]
    resolution: float = RESOLUTION  # [m] edge length of a voxel
    frame: str = ""


def load_sensors_3d(file: str | Path) -> Sensors3d:
    """Read the octomap updaters from MoveIt's sensors_3d.yaml in ROS 1 or ROS 2 format.

    Raises:
        InputError: unknown plugin or key, or a value of the wrong type; the error names file and entry.
    """
    path = Path(file)
    data: Any = read_yaml(path)
    while set(data) & {"/**", "move_group", "ros__parameters"}:
        data = next(data[k] for k in ("/**", "move_group", "ros__parameters") if k in data)
    sensors = []
    for i, entry in enumerate(data.get("sensors") or []):
        name = entry if isinstance(entry, str) else str(i)
        if isinstance(entry, str):
            if not isinstance(data.get(entry), Mapping):
                known = [k for k, v in data.items() if isinstance(v, Mapping)]
                raise UnknownNameError("sensor", entry, known, file=path, element="sensors")
            entry = data[entry]
        if entry:  # the setup assistant writes an empty entry
            sensors.append(_sensor(entry, path, f"sensors/{name}"))
    resolution = data.get("octomap_resolution", RESOLUTION)
    if not isinstance(resolution, int | float) or not resolution > 0:
        raise InputError(
            f"is {resolution!r}, it must be a positive length", file=path, element="octomap_resolution"
        )
    return Sensors3d(tuple(sensors), float(resolution), str(data.get("octomap_frame", "")))


def _sensor(entry: Any, file: Path, element: str) -> Sensor3d:
    if not isinstance(entry, Mapping):
        raise InputError("is not a mapping", file=file, element=element)
    plugin = str(entry.get("sensor_plugin", "")).rpartition("/")[2]
    if plugin not in (CLOUD, DEPTH):
        raise UnknownNameError("sensor_plugin", plugin, (CLOUD, DEPTH), file=file, element=element)
    known = {f.name for f in fields(Sensor3d)}
    ignored = {"sensor_plugin", "ns"}
    floats = {f.name for f in fields(Sensor3d) if f.type == "float"}
    values = {k: float(v) if k in floats and isinstance(v, int) else v for k, v in entry.items()}
    for key in values:
        if key not in known | ignored:
            raise UnknownNameError("key", key, sorted(known), file=file, element=element)
    try:
        return settings_from(Sensor3d, {k: v for k, v in values.items() if k not in ignored}, element)
    except InputError as error:
        raise InputError(error.reason, file=file, element=element, hint=error.hint) from None


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
