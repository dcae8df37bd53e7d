"""What cameras see: clouds, planes, objects with poses, occupancy, markers. Knows no tasks and no physics."""

from armcell.perception.camera_info import CameraInfo, load_camera_info, rectified, save_camera_info
from armcell.perception.cloud import organised
from armcell.perception.known import closest_equivalent, pose_error
from armcell.perception.look import LookSettings, SeenObject, Sight, look
from armcell.perception.mapping import CameraMap, MapSettings, MapUpdate
from armcell.perception.plane import SupportPlane, find_plane

__all__ = [
    "CameraInfo",
    "CameraMap",
    "LookSettings",
    "MapSettings",
    "MapUpdate",
    "SeenObject",
    "Sight",
    "SupportPlane",
    "closest_equivalent",
    "find_plane",
    "load_camera_info",
    "look",
    "organised",
    "pose_error",
    "rectified",
    "save_camera_info",
]
