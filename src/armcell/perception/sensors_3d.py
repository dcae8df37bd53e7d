"""Reader of MoveIt's sensors_3d.yaml: clouds and depth images that feed the octomap.

Source of keys and defaults: moveit_ros_perception's PointCloudOctomapUpdater and DepthImageOctomapUpdater.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from armcell.core import InputError, UnknownNameError
from armcell.core.checks import checked, settings_from
from armcell.model.untrusted_files import read_yaml

RESOLUTION = 0.05  # [m] default of the file's value
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
    """Read MoveIt's sensors_3d.yaml in ROS 1 or ROS 2 format.

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
