"""Pictures and clouds as files: round trips, and what is broken is named."""

from __future__ import annotations

import contextlib
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer
from PIL import Image
from rosbags.typesys import Stores, get_typestore
from tests.perception.scenes import random_scene

from armcell.core import SE3, InputError
from armcell.perception import (
    cloud_image,
    draw_detections,
    load_image,
    load_record,
    look,
    organized_cloud,
    pose_error,
    save_image,
)
from armcell.perception.camera_files import load_depth
from armcell.sim import DepthNoise

STORE = get_typestore(Stores.ROS2_HUMBLE)


@pytest.fixture(scope="module")
def seen():
    return random_scene(4, noise=DepthNoise.for_stereo())


def found_as(scene, sight) -> None:
    """Every object within 2 mm."""
    for name, item in scene.objects.items():
        T = scene.truth(name)
        off = [
            np.linalg.norm(o.T_world_object.translation - T.translation)
            for o in sight.objects
            if o.T_world_object is not None and type(o.shapes[0][0]) is type(item.shapes[0][0])
        ]
        assert min(off) < 0.002, name


@pytest.mark.slow
def test_png_and_yaml(seen, tmp_path):
    written = save_image(tmp_path / "shot", seen.image)
    assert [p.name for p in written] == ["shot.yaml", "shot_rgb.png", "shot_depth.png"]
    back = load_image(tmp_path / "shot.yaml")
    assert back.T_world_camera.isclose(seen.image.T_world_camera, 1e-9, 1e-9)
    assert np.array_equal(back.rgb, seen.image.rgb)
    assert np.abs(back.depth - seen.image.depth).max() <= 0.0005 + 1e-6
    found_as(seen, look(back))
    moved = load_image(
        tmp_path / "shot.yaml", depth=tmp_path / "shot_depth.png", T_world_camera=SE3.identity()
    )
    assert moved.rgb is None and moved.T_world_camera.isclose(SE3.identity())
    np.save(tmp_path / "meters.npy", seen.image.depth)
    exact = load_image(tmp_path / "shot.yaml", depth=tmp_path / "meters.npy")
    assert np.array_equal(exact.depth, seen.image.depth)


@pytest.mark.slow
def test_a_cloud_without_rows_and_columns(seen):
    points = seen.image.T_world_camera.apply(
        organized_cloud(seen.image.depth, seen.image.pinhole).reshape(-1, 3)
    )
    points = points[np.isfinite(points[:, 0])]
    rng = np.random.default_rng(0)
    found_as(seen, look(cloud_image(rng.permutation(points), seen.image.T_world_camera)))
    with pytest.raises(InputError, match="in front of the camera"):
        cloud_image(points - [0, 0, 10], SE3.identity())


def record(path: Path, image, with_info: bool = True) -> None:
    """As rosbag2 writes it: static transform, info, color and depth, a cloud."""
    t = STORE.types
    header = t["std_msgs/msg/Header"](t["builtin_interfaces/msg/Time"](3, 500_000_000), "eye")
    p, (h, w) = image.pinhole, image.depth.shape
    K = p.matrix.ravel()
    roi = t["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    info = t["sensor_msgs/msg/CameraInfo"](
        header, h, w, "plumb_bob", np.zeros(5), K, np.eye(3).ravel(), np.zeros(12), 0, 0, roi
    )
    rgb = t["sensor_msgs/msg/Image"](header, h, w, "bgr8", 0, 3 * w, image.rgb[..., ::-1].ravel())
    raw = np.frombuffer(np.rint(image.depth * 1000).astype("<u2").tobytes(), np.uint8)
    depth = t["sensor_msgs/msg/Image"](header, h, w, "16UC1", 0, 2 * w, raw)
    T = image.T_world_camera
    q = t["geometry_msgs/msg/Quaternion"](*T.quat_xyzw)
    moved = t["geometry_msgs/msg/Transform"](t["geometry_msgs/msg/Vector3"](*T.translation), q)
    world = t["std_msgs/msg/Header"](header.stamp, "world")
    tf = t["tf2_msgs/msg/TFMessage"]([t["geometry_msgs/msg/TransformStamped"](world, "eye", moved)])
    messages = [("/tf_static", tf), ("/color", rgb), ("/depth", depth)]
    messages += [("/info", info)] if with_info else []
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="test")
        for topic, message in messages:
            kind = message.__msgtype__
            text = STORE.generate_msgdef(kind, ros_version=2)[0].encode()
            channel = writer.register_channel(topic, "cdr", writer.register_schema(kind, "ros2msg", text))
            writer.add_message(channel, 0, bytes(STORE.serialize_cdr(message, kind)), 0)
        writer.finish()


@pytest.mark.slow
def test_mcap(seen, tmp_path):
    record(tmp_path / "a.mcap", seen.image)
    found = load_record(tmp_path / "a.mcap").image()
    assert found.time == 3.5 and found.pinhole == seen.image.pinhole
    assert np.array_equal(found.rgb, seen.image.rgb)
    assert found.T_world_camera.isclose(seen.image.T_world_camera, 1e-9, 1e-9)
    found_as(seen, look(found))


def test_broken_records_are_named(seen, tmp_path):
    record(tmp_path / "b.mcap", seen.image, with_info=False)
    with pytest.raises(InputError, match=r"b.mcap.*no CameraInfo.*camera_info"):
        load_record(tmp_path / "b.mcap").image()
    whole = (tmp_path / "b.mcap").read_bytes()
    for size in (0, 5, 100, len(whole) // 2):
        (tmp_path / "cut.mcap").write_bytes(whole[:size])
        with pytest.raises(InputError, match=r"cut.mcap"):
            load_record(tmp_path / "cut.mcap").image()
    with pytest.raises(InputError, match="cannot be read"):
        load_record(tmp_path / "none.mcap")


def test_broken_pictures_are_named(seen, tmp_path):
    save_image(tmp_path / "shot", seen.image)
    with pytest.raises(InputError, match="depth needs 16 bits"):
        load_image(tmp_path / "shot.yaml", depth=tmp_path / "shot_rgb.png")
    (tmp_path / "text.png").write_text("no picture")
    with pytest.raises(InputError, match=r"text.png.*cannot be read as a picture"):
        load_image(tmp_path / "shot.yaml", rgb=tmp_path / "text.png")
    with pytest.raises(InputError, match=r"nothing.png.*cannot be read"):
        load_image(tmp_path / "shot.yaml", rgb=tmp_path / "nothing.png")
    Image.new("RGB", (10, 10)).save(tmp_path / "small.png")
    with pytest.raises(InputError, match=r"shot.yaml.*shape"):
        load_image(tmp_path / "shot.yaml", rgb=tmp_path / "small.png")
    (tmp_path / "shot_rgb.png").rename(tmp_path / "x.png")
    (tmp_path / "shot_depth.png").unlink()
    with pytest.raises(InputError, match="no shot_rgb.png"):
        load_image(tmp_path / "shot.yaml")
    with (tmp_path / "z.npy").open("wb") as file:
        np.savez(file, depth=np.zeros((2, 2)))
    with pytest.raises(InputError, match="archive"):
        load_image(tmp_path / "shot.yaml", depth=tmp_path / "z.npy")
    np.save(tmp_path / "z.npy", np.zeros(5))
    with pytest.raises(InputError, match="meters"):
        load_image(tmp_path / "shot.yaml", depth=tmp_path / "z.npy")


def test_a_damaged_chunk_length_reserves_no_memory(tmp_path):
    file = tmp_path / "depth.png"
    Image.fromarray(np.full((6, 8), 500, np.uint16)).save(file)
    data = file.read_bytes()
    at = data.index(b"IDAT") - 4
    file.write_bytes(data[:at] + (2**31 - 1).to_bytes(4, "big") + data[at + 4 :])
    tracemalloc.start()
    try:
        with contextlib.suppress(InputError):
            load_depth(file)
        assert tracemalloc.get_traced_memory()[1] < 10_000_000
    finally:
        tracemalloc.stop()


@pytest.mark.slow
def test_what_is_seen_is_drawn_where_it_is(seen):
    """The outline is near the object's pixels, and only there."""
    sight = look(seen.image, seen.world.built.scene, tuple(seen.objects.values()))
    changed = np.any(draw_detections(seen.image, sight) != seen.image.rgb, axis=2)
    assert changed.sum() > 200
    for name in seen.objects:
        T = sight[name].T_world_object
        assert pose_error(sight[name].shapes, T, seen.truth(name))[0] < 0.002
        ((u, v),) = seen.image.pinhole.project(seen.image.T_world_camera.inverse().apply(T.translation))
        assert changed[int(v) - 15 : int(v) + 15, int(u) - 15 : int(u) + 15].sum() > 20
