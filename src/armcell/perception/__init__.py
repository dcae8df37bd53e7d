"""Camera perception: point clouds, planes, object poses, occupancy maps and markers.

The package is independent of tasks and physics.
"""

from armcell.perception.bag import CameraRecord, cloud_points, depth_pixels, load_record
from armcell.perception.camera_info import CameraInfo, load_camera_info, rectified, save_camera_info
from armcell.perception.cloud import organized
from armcell.perception.colors import color_distance, color_name
from armcell.perception.draw import drawn
from armcell.perception.files import cloud_image, load_image, save_image
from armcell.perception.hand_eye import HandEye, calibrate_hand_eye
from armcell.perception.heights import height_map, pieces
from armcell.perception.known import closest_equivalent, pose_error
from armcell.perception.look import LookSettings, SeenObject, Sight, look, unusable
from armcell.perception.mapping import CameraMap, MapSettings, MapUpdate
from armcell.perception.markers import (
    FAMILIES,
    MarkerSight,
    SeenMarker,
    find_markers,
    marker_picture,
    picture_size,
)
from armcell.perception.plane import SupportPlane, find_plane
from armcell.perception.sensor_map import SensorMap
from armcell.perception.sensors_3d import Sensor3d, Sensors3d, load_sensors_3d

__all__ = [
    "FAMILIES",
    "CameraInfo",
    "CameraMap",
    "CameraRecord",
    "HandEye",
    "LookSettings",
    "MapSettings",
    "MapUpdate",
    "MarkerSight",
    "SeenMarker",
    "SeenObject",
    "Sensor3d",
    "SensorMap",
    "Sensors3d",
    "Sight",
    "SupportPlane",
    "calibrate_hand_eye",
    "closest_equivalent",
    "cloud_image",
    "cloud_points",
    "color_distance",
    "color_name",
    "depth_pixels",
    "drawn",
    "find_markers",
    "find_plane",
    "height_map",
    "load_camera_info",
    "load_image",
    "load_record",
    "load_sensors_3d",
    "look",
    "marker_picture",
    "organized",
    "picture_size",
    "pieces",
    "pose_error",
    "rectified",
    "save_camera_info",
    "save_image",
    "unusable",
]
