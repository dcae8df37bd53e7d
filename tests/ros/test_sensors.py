"""Clouds from another process over a real wire become the octomap that plans avoid."""

import sys
import time
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from tests.programs import Program
from tests.ros.cloud_publisher import TOPIC

from armcell.cell import load
from armcell.collision import ExactChecker
from armcell.core import SE3, SO3
from armcell.perception import load_sensors_3d
from armcell.ros import Bus, schema
from armcell.ros.convert import cloud_message, transform_message
from armcell.ros.nodes import ServedCell
from armcell.ros.tcp import RosTcpServer, ServerSettings

S = schema()
EYE = (1.6, 0.0, 0.9)
SWING = 1.2  # [rad] of the first joint from start to goal; half on the way is an obstacle
FILE = f"""
sensors:
  - sensor_plugin: occupancy_map_monitor/PointCloudOctomapUpdater
    point_cloud_topic: {TOPIC}
    max_range: 5.0
    point_subsample: 1
    padding_offset: 0.04
    padding_scale: 1.0
    max_update_rate: 20.0
    filtered_cloud_topic: /filtered
  - sensor_plugin: occupancy_map_monitor/DepthImageOctomapUpdater
    image_topic: /depth/image
    far_clipping_plane_distance: 3.0
    skip_horizontal_pixels: 2
    padding_offset: 0.04
octomap_resolution: 0.03
"""


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    file = tmp_path_factory.mktemp("config") / "sensors_3d.yaml"
    file.write_text(FILE)
    live = load("panda_table").connect("fake", None, time_scale=10.0)
    with ServedCell(live, Bus(), sensors=load_sensors_3d(file)) as cell:
        yield cell


@contextmanager
def published(server, folder, points):
    """A process that publishes a cloud."""
    file = folder / "points.npy"
    np.save(file, points)
    process = Program(
        [
            sys.executable,
            "-m",
            "tests.ros.cloud_publisher",
            str(server.address[1]),
            str(file),
            *map(str, EYE),
        ],
        cwd=Path(__file__).parents[2],
    )
    try:
        yield
    finally:
        process.terminate()
        process.wait(10)


def robot_points(scene):
    """Points on the surface of the robot's links."""
    found = []
    for link in scene.model.links.values():
        for c in link.collisions:
            if hasattr(c.shape, "vertices"):
                found.append((scene.frame_pose(link.name) @ c.T_link_shape).apply(c.shape.vertices[::7]))
    return np.vstack(found)


def wall(scene):
    """Points (n, 3) [m] of an upright plate across the tool's path, and the plate's center."""
    tip = scene.frame_pose(next(iter(scene.model.grippers.values())).tcp_link).translation
    turn = SO3.from_rpy((0.0, 0.0, SWING / 2)).matrix
    across, up = np.meshgrid(np.arange(-0.1, 0.1, 0.01), np.arange(-0.1, 0.1, 0.01))
    plate = np.column_stack([across.ravel(), np.zeros(across.size), up.ravel()])
    return (plate + tip) @ turn.T, turn @ tip


def plan(served, shift):
    """A plan over /plan_kinematic_path by which the first joint swings past the obstacle."""
    group = next(iter(served.live.arms))
    now = served.cell.scene().state
    names = served.live.model.group(group).joint_names
    asked = S.new("moveit_msgs/MotionPlanRequest", group_name=group, allowed_planning_time=10.0)
    asked.start_state.is_diff = True
    joints = [
        S.new("moveit_msgs/JointConstraint", n, float(now[n]) + (shift if i == 0 else 0.0), 1e-3, 1e-3, 1.0)
        for i, n in enumerate(names)
    ]
    asked.goal_constraints = [S.new("moveit_msgs/Constraints", joint_constraints=joints)]
    request = S.new("moveit_msgs/GetMotionPlanRequest", asked)
    return served.bus.call("/plan_kinematic_path", request).motion_plan_response


def free(scene, response):
    """Whether the straight parts of a planned trajectory are free of contacts in a scene."""
    trajectory = response.trajectory.joint_trajectory
    checker = ExactChecker(scene, tuple(trajectory.joint_names))
    Q = np.array([p.positions for p in trajectory.points])
    dense = np.vstack([np.linspace(a, b, 4) for a, b in pairwise(Q)])
    return not any(checker.contacts(q) for q in dense)


def until(condition, seconds=30.0):
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.05)
    assert condition()


@pytest.mark.slow
def test_a_cloud_of_another_process_is_avoided_and_the_robot_in_it_is_not(served, tmp_path):
    bus, cell = served.bus, served.cell
    arm, (points, center) = robot_points(cell.scene()), wall(cell.scene())
    unseen = np.full((500, 3), np.nan)
    before = plan(served, SWING)
    assert before.error_code.val == 1
    filtered = bus.subscribe("/filtered", "sensor_msgs/PointCloud2", queue_size=1)
    with (
        RosTcpServer(bus, ServerSettings(port=0)) as server,
        published(server, tmp_path, np.vstack([points, arm, unseen])),
    ):
        until(lambda: "<octomap>" in cell.scene().objects)
        scene = cell.scene()
        # The wall is there; what the robot shows of itself, and what was not seen, is not.
        octree = scene.object("<octomap>")
        low, high = octree.bounds()
        assert np.all(low >= center - 0.2) and np.all(high <= center + 0.2)
        valid = bus.call("/check_state_validity", S.new("moveit_msgs/GetStateValidityRequest"))
        assert valid.valid, valid.contacts
        assert filtered.get(10).width <= len(points)
        # The message of the scene has the octomap.
        asked = S.new("moveit_msgs/GetPlanningSceneRequest")
        asked.components.components = 1023
        told = bus.call("/get_planning_scene", asked).scene.world.octomap
        assert len(told.octomap.data) > 10 and told.octomap.resolution == pytest.approx(0.03)
        after = plan(served, SWING)
        assert after.error_code.val == 1
        assert not free(scene, before) and free(scene, after)
    # Without the sensor it stays, until it is cleared.
    assert "<octomap>" in cell.scene().objects
    time.sleep(0.5)
    bus.call("/clear_octomap", S.new("std_srvs/EmptyRequest"))
    assert "<octomap>" not in cell.scene().objects


@pytest.fixture
def clean(served):
    yield
    for _ in range(20):  # until no image that was still in the queue brings the map back
        served.bus.call("/clear_octomap", S.new("std_srvs/EmptyRequest"))
        time.sleep(0.2)
        if "<octomap>" not in served.cell.scene().objects:
            return


def stamped(frame, seconds=0.0):
    return S.new(
        "std_msgs/Header", stamp=S.message("builtin_interfaces/Time").from_sec(seconds), frame_id=frame
    )


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [np.float32, np.uint16])
def test_a_depth_image_with_its_camera_info_is_mapped(served, clean, dtype):
    bus, h, w, f = served.bus, 48, 64, 60.0
    # A camera that looks down along -z of the world, 1 m above an object 0.4 m below it.
    at = SE3(SO3.from_rpy((np.pi, 0.0, 0.0)), np.array([0.1, 0.7, 1.3]))
    tf = bus.advertise("/tf_static", "tf2_msgs/TFMessage", latch=True)
    tf.publish(S.new("tf2_msgs/TFMessage", [transform_message(S, stamped("world"), "optical", at)]))
    info = bus.advertise("/depth/camera_info", "sensor_msgs/CameraInfo")
    K = np.array([f, 0, w / 2, 0, f, h / 2, 0, 0, 1.0])
    info.publish(S.new("sensor_msgs/CameraInfo", stamped("optical"), height=h, width=w, K=K))
    depth = np.zeros((h, w), dtype)
    depth[20:28, 28:36] = 0.4 if dtype is np.float32 else 400
    depth[:, :2] = 0.5 if dtype is np.float32 else 500  # at the edge: skipped
    depth[0, 30] = 9.0 if dtype is np.float32 else 9000  # too far
    image = S.new(
        "sensor_msgs/Image", stamped("optical"), h, w, "32FC1" if dtype is np.float32 else "16UC1", False,
        w * depth.itemsize, np.frombuffer(depth.tobytes(), np.uint8),
    )  # fmt: skip
    publisher = bus.advertise("/depth/image", "sensor_msgs/Image")
    until(lambda: publisher.publish(image) or "<octomap>" in served.cell.scene().objects)
    octree = served.cell.scene().object("<octomap>")
    low, high = octree.bounds()
    center = at.apply((0.0, 0.0, 0.4))
    assert np.all(low >= center - 0.09) and np.all(high <= center + 0.09)
    for member in (tf, info, publisher):
        member.close()


@pytest.mark.slow
def test_the_robot_in_a_late_cloud_is_taken_as_it_stood(served, clean):
    bus, cell = served.bus, served.cell
    group = next(iter(served.live.arms))
    before, stamp = cell.scene(), bus.clock.now()
    points = robot_points(before).astype(np.float32)
    request = plan(served, 1.0)
    assert cell.queue_trajectory(request.trajectory.joint_trajectory).wait(30)
    moved = abs(cell.scene().positions - before.positions).max()
    assert moved > 0.9, group
    publisher = bus.advertise(TOPIC, "sensor_msgs/PointCloud2")
    for _ in range(5):
        publisher.publish(cloud_message(S, stamped("world", stamp), points[None]))
        time.sleep(0.2)
    assert "<octomap>" not in cell.scene().objects

    def now():  # the same points as if they were seen where the robot is not any more
        publisher.publish(cloud_message(S, stamped("world", bus.clock.now()), points[None]))
        return "<octomap>" in cell.scene().objects

    until(now)
    publisher.close()


def test_a_frame_that_nothing_connects_is_reported(served, caplog):
    publisher = served.bus.advertise(TOPIC, "sensor_msgs/PointCloud2")
    message = cloud_message(S, stamped("lost"), np.ones((1, 4, 3), np.float32))
    until(lambda: publisher.publish(message) or "frame 'lost' is not connected with the robot" in caplog.text)
    assert "publish a transform" in caplog.text
    publisher.close()


@pytest.mark.slow
def test_a_cell_and_a_moveit_package_name_their_sensors(tmp_path):
    (tmp_path / "sensors_3d.yaml").write_text(FILE)
    (tmp_path / "cell.yaml").write_text("robot: panda\nros: {sensors: sensors_3d.yaml}\n")
    cell = load(tmp_path)
    assert cell.sensors is not None and len(cell.sensors.sensors) == 2
    assert cell.connect("fake", None).sensors is cell.sensors
    assert load("panda_table").sensors is None
