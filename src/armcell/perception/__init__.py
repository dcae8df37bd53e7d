"""Camera perception: point clouds, planes, object poses, occupancy maps and markers.

The package is independent of tasks and physics.
"""

from armcell.perception.bag import CameraRecord, cloud_points, depth_pixels, load_record
from armcell.perception.camera_files import (
    CameraInfo,
    cloud_image,
    load_camera_info,
    load_image,
    rectified,
    save_camera_info,
    save_image,
)
from armcell.perception.cloud import SupportPlane, find_plane, organized_cloud
from armcell.perception.colors import color_distance, color_name
from armcell.perception.draw import draw_detections
from armcell.perception.hand_eye import HandEye, calibrate_hand_eye
from armcell.perception.height_maps import height_map, label_pieces
from armcell.perception.image_checks import check_image
from armcell.perception.known_object_pose import closest_equivalent, pose_error
from armcell.perception.markers import (
    FAMILIES,
    DetectedMarker,
    MarkerDetections,
    find_markers,
    marker_picture,
    picture_size,
)
from armcell.perception.object_detection import (
    DetectedObject,
    DetectionResult,
    look,
)
from armcell.perception.occupancy_maps import (
    CameraMap,
    MapSettings,
    MapUpdate,
    Sensor3d,
    SensorMap,
    Sensors3d,
    load_sensors_3d,
)
from armcell.perception.segmentation import LookSettings

__all__ = [
    "FAMILIES",
    "CameraInfo",
    "CameraMap",
    "CameraRecord",
    "DetectedMarker",
    "DetectedObject",
    "DetectionResult",
    "HandEye",
    "LookSettings",
    "MapSettings",
    "MapUpdate",
    "MarkerDetections",
    "Sensor3d",
    "SensorMap",
    "Sensors3d",
    "SupportPlane",
    "calibrate_hand_eye",
    "check_image",
    "closest_equivalent",
    "cloud_image",
    "cloud_points",
    "color_distance",
    "color_name",
    "depth_pixels",
    "draw_detections",
    "find_markers",
    "find_plane",
    "height_map",
    "label_pieces",
    "load_camera_info",
    "load_image",
    "load_record",
    "load_sensors_3d",
    "look",
    "marker_picture",
    "organized_cloud",
    "picture_size",
    "pose_error",
    "rectified",
    "save_camera_info",
    "save_image",
]
