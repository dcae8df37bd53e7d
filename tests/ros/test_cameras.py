"""A cell's cameras on the bus: rate, contents, frames, what a slow subscriber gets."""

from __future__ import annotations

import numpy as np
import pytest

from armcell.cell import load
from armcell.core import SE3
from armcell.perception import cloud_points, organized_cloud
from armcell.ros import Bus
from armcell.ros.nodes import CameraPublisher

CELL = """
robot: panda
objects:
  table: {box: [1.2, 1.2, 0.04], pose: [0.5, 0, -0.021]}
cameras:
  top: {eye: [0.9, 0.2, 0.8], target: [0.5, 0, 0], width: 64, height: 48, rate: 10}
  hand:
    {on: panda_hand, pose: {xyz: [0.06, 0, 0.02], rpy_deg: [0, 0, 90]}, width: 32, height: 24, depth: false}
"""


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cameras")
    (folder / "cell.yaml").write_text(CELL)
    return load(folder)


def run(live, bus: Bus, cameras: CameraPublisher, seconds: float, tf=None) -> None:
    for _ in range(round(seconds / live.driver.period)):
        live.driver.advance(live.driver.period)
        bus.clock.set(live.driver.now)
        cameras.publish(tf)


@pytest.mark.slow
def test_pictures_clouds_and_info_at_their_rate(cell):
    bus = Bus()
    with cell.connect() as live:
        cameras = CameraPublisher(bus, live.cameras)
        topics = ("color/image_raw", "color/camera_info", "depth/image_rect_raw", "depth/points")
        types = ("Image", "CameraInfo", "Image", "PointCloud2")
        subs = [
            bus.subscribe(f"/top/{t}", f"sensor_msgs/{k}", queue_size=100)
            for t, k in zip(topics, types, strict=True)
        ]
        run(live, bus, cameras, 0.98)
        got = [[] for _ in subs]
        for sub, messages in zip(subs, got, strict=True):
            while (m := sub.get(0)) is not None:
                messages.append(m)
        assert [len(messages) for messages in got] == [10, 10, 10, 10]
        stamps = [m.header.stamp.to_sec() for m in got[0]]
        assert np.diff(stamps) == pytest.approx(np.full(9, 0.1), abs=0.006)
        color, info, depth, cloud = (messages[-1] for messages in got)
        image = live.camera("top").image()
        assert {m.header.frame_id for m in (color, info, depth, cloud)} == {"top_optical_frame"}
        assert color.encoding == "rgb8" and color.step == 64 * 3
        assert np.array_equal(np.frombuffer(bytes(color.data), np.uint8).reshape(48, 64, 3), image.rgb)
        z = np.frombuffer(bytes(depth.data), "<f4").reshape(48, 64)
        assert depth.encoding == "32FC1" and np.array_equal(np.nan_to_num(z), image.depth)
        assert np.isnan(z).any() == (image.depth == 0).any()
        np.testing.assert_allclose(np.reshape(info.K, (3, 3)), image.pinhole.matrix)
        points = organized_cloud(image.depth, image.pinhole).reshape(-1, 3)
        np.testing.assert_allclose(cloud_points(cloud), points, atol=1e-6)
        table = np.frombuffer(bytes(cloud.data), "<u4").reshape(48, 64, 4)
        assert np.array_equal((table[..., 3] >> 16) & 255, image.rgb[..., 0])
        cameras.close()
        assert not [t for t in bus.topics() if t.publishers]


@pytest.mark.slow
def test_a_slow_subscriber_gets_the_newest_and_nobody_waits(cell):
    bus = Bus()
    with cell.connect() as live:
        cameras = CameraPublisher(bus, live.cameras)
        slow = bus.subscribe("/top/depth/image_rect_raw", "sensor_msgs/Image", queue_size=1)
        run(live, bus, cameras, 0.98)
        assert slow.dropped == 9
        assert slow.get(0).header.stamp.to_sec() > 0.85 and slow.get(0) is None


@pytest.mark.slow
def test_frames_lead_to_the_camera(cell):
    """World to optical frame along /tf is where the picture says it was taken; also on the hand."""
    bus = Bus()
    with cell.connect() as live:
        cameras = CameraPublisher(bus, live.cameras)
        tf = bus.advertise("/tf", "tf2_msgs/TFMessage")
        sub = bus.subscribe("/tf", "tf2_msgs/TFMessage", queue_size=10)
        run(live, bus, cameras, 0.01, tf)
        frames = {}
        while (m := sub.get(0)) is not None:
            for t in m.transforms:
                p, q = t.transform.translation, t.transform.rotation
                T = SE3.from_quat_xyzw([p.x, p.y, p.z], [q.x, q.y, q.z, q.w])
                frames[t.child_frame_id] = (t.header.frame_id, T)
        for name, parent in (("top", "world"), ("hand", "panda_hand")):
            above, T_parent_link = frames[f"{name}_link"]
            middle, T_link_optical = frames[f"{name}_optical_frame"]
            assert (above, middle) == (parent, f"{name}_link")
            T = live.scene().frame_pose(parent) @ T_parent_link @ T_link_optical
            assert T.isclose(live.camera(name).image().T_world_camera, 1e-6, 1e-6)
            # REP-103: x of the camera's link is where it looks
            np.testing.assert_allclose(T_link_optical.rotation.matrix[:, 2], [1, 0, 0], atol=1e-9)


def test_nothing_is_drawn_for_nobody_and_no_depth_is_no_topic(cell):
    bus = Bus()
    with cell.connect() as live:
        cameras = CameraPublisher(bus, live.cameras)
        run(live, bus, cameras, 0.3)
        assert all(camera.due() for camera in live.cameras.values())  # none was asked for a picture
        names = {t.name for t in bus.topics()}
        assert "/hand/color/image_raw" in names and "/hand/depth/points" not in names
