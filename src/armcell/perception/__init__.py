"""What cameras see: clouds, planes, objects with poses, occupancy, markers. Knows no tasks and no physics."""

from armcell.perception.camera_info import CameraInfo, load_camera_info, rectified, save_camera_info
from armcell.perception.cloud import organised
from armcell.perception.hand_eye import HandEye, calibrate_hand_eye
from armcell.perception.known import closest_equivalent, pose_error
from armcell.perception.look import LookSettings, SeenObject, Sight, look
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

__all__ = [
    "FAMILIES",
    "CameraInfo",
    "CameraMap",
    "HandEye",
    "LookSettings",
    "MapSettings",
    "MapUpdate",
    "MarkerSight",
    "SeenMarker",
    "SeenObject",
    "Sight",
    "SupportPlane",
    "calibrate_hand_eye",
    "closest_equivalent",
    "find_markers",
    "find_plane",
    "load_camera_info",
    "look",
    "marker_picture",
    "organised",
    "picture_size",
    "pose_error",
    "rectified",
    "save_camera_info",
]
