"""MoveIt's sensors_3d.yaml in both forms, and the octomap that several sensors feed."""

import numpy as np
import pytest

from armcell.cell import load
from armcell.core import SE3, InputError
from armcell.perception import Sensor3d, SensorMap, load_sensors_3d

CLOUD = """
sensors:
  - sensor_plugin: occupancy_map_monitor/PointCloudOctomapUpdater
    point_cloud_topic: /camera/depth/points
    max_range: 5
    point_subsample: 2
    padding_offset: 0.1
    padding_scale: 1.5
    max_update_rate: 1.0
    filtered_cloud_topic: filtered_cloud
  - {}
octomap_resolution: 0.02
octomap_frame: world
"""
DEPTH = """
/**:
  ros__parameters:
    sensors: [kinect]
    kinect:
      sensor_plugin: occupancy_map_monitor/DepthImageOctomapUpdater
      image_topic: /camera/depth/image_raw
      queue_size: 5
      near_clipping_plane_distance: 0.3
      far_clipping_plane_distance: 5.0
      shadow_threshold: 0.2
      padding_scale: 4.0
      padding_offset: 0.03
      max_update_rate: 1.0
      filtered_cloud_topic: filtered_cloud
      ns: kinect
"""


def read(tmp_path, text):
    file = tmp_path / "sensors_3d.yaml"
    file.write_text(text)
    return load_sensors_3d(file)


def test_clouds_in_ros1s_form(tmp_path):
    found = read(tmp_path, CLOUD)
    (sensor,) = found.sensors  # the empty one is none
    assert (found.resolution, found.frame) == (0.02, "world")
    assert sensor.topic == "/camera/depth/points" and sensor.max_range == 5.0
    assert (sensor.point_subsample, sensor.padding_offset, sensor.padding_scale) == (2, 0.1, 1.5)
    assert (sensor.max_update_rate, sensor.filtered_cloud_topic) == (1.0, "filtered_cloud")


def test_depth_images_in_ros2s_form(tmp_path):
    (sensor,) = read(tmp_path, DEPTH).sensors
    assert (sensor.topic, sensor.info_topic) == ("/camera/depth/image_raw", "/camera/depth/camera_info")
    assert (sensor.near_clipping_plane_distance, sensor.far_clipping_plane_distance) == (0.3, 5.0)


@pytest.mark.parametrize(
    "before, after, words",
    [
        ("PointCloudOctomapUpdater", "LaserUpdater", "unknown sensor_plugin 'LaserUpdater'"),
        ("max_range: 5", "max_rang: 5", "unknown key 'max_rang'"),
        ("max_range: 5", "max_range: far", "max_range"),
        ("point_subsample: 2", "point_subsample: 0", "point_subsample is 0"),
        ("point_cloud_topic: /camera/depth/points", "queue_size: 1", "needs a point_cloud_topic"),
        ("octomap_resolution: 0.02", "octomap_resolution: fine", "octomap_resolution"),
        ("  - {}", "  - kinect", "unknown sensor 'kinect'"),
    ],
)
def test_what_is_wrong_is_named_with_the_file(tmp_path, before, after, words):
    with pytest.raises(InputError, match="sensors_3d.yaml") as raised:
        read(tmp_path, CLOUD.replace(before, after))
    assert words in str(raised.value)


# --- the map ---
@pytest.fixture(scope="module")
def scene():
    return load("panda_pick").scene(0)


SENSOR = Sensor3d(point_cloud_topic="/c", padding_offset=0.03, max_range=2.0)
EYE = SE3.from_xyz(1.5, 0.0, 0.8)


def seen(scene, *world, sensor=SENSOR, onto=None):
    found = onto or SensorMap(0.02)
    found.update(EYE.inverse().apply(np.array(world, float)), EYE, scene, sensor)
    return found


@pytest.mark.slow
def test_the_robot_and_known_objects_are_filtered_out(scene):
    hand = scene.frame_pose("panda_hand").translation
    cube = scene.object("cube").T_world_object.translation
    assert not len(seen(scene, hand, cube).octree.sizes)
    assert len(seen(scene, hand, cube, (0.3, 0.6, 0.5)).octree.sizes) == 1


def test_a_held_object_is_filtered_out_where_the_hand_holds_it(scene):
    between = scene.with_object_pose("cube", scene.frame_pose("panda_hand_tcp"))
    held = between.with_attached("cube", "panda_hand_tcp", ("panda_hand",))
    moved = held.with_positions(held.positions + np.eye(len(held.positions))[0] * 0.8)
    there = moved.frame_pose("panda_hand_tcp") @ held.attached["cube"].T_link_object
    inside = there.apply((0.0, 0.0, 0.02))
    assert not len(seen(moved, inside).octree.sizes)
    assert len(seen(scene, inside).octree.sizes) == 1


def test_rays_clear_what_has_gone_and_far_points_are_no_obstacles(scene):
    point = np.array((0.31, 0.61, 0.51))
    behind = EYE.translation + 1.3 * (point - EYE.translation)
    found = seen(scene, point)
    assert len(found.octree.sizes) == 1
    for _ in range(5):
        seen(scene, behind, onto=found)
    assert found.map.at([point])[0] < 0
    assert not len(seen(scene, (-3.0, 0.6, 0.5)).octree.sizes)  # beyond max_range


def test_what_is_not_seen_and_subsampled_points_do_not_count(scene):
    points = [(np.nan, 0, 0), (0.3, 0.6, 0.5), (0.3, 0.7, 0.5), (np.inf, 1, 1)]
    every = Sensor3d(point_cloud_topic="/c", point_subsample=2)
    assert len(seen(scene, *points).octree.sizes) == 2
    assert len(seen(scene, *points, sensor=every).octree.sizes) == 1


def test_padding_scale_grows_the_links(scene):
    wrist = scene.frame_pose("panda_link5").translation
    near = wrist + np.array([0.0, 0.16, 0.0])
    scaled = Sensor3d(point_cloud_topic="/c", padding_scale=2.5)
    plain = Sensor3d(point_cloud_topic="/c")
    assert len(seen(scene, near, sensor=plain).octree.sizes) == 1
    assert not len(seen(scene, near, sensor=scaled).octree.sizes)
