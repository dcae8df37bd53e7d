"""Encoding and decoding: every type there and back, known bytes, bad bytes, speed."""

import contextlib
import struct
import sys
import threading
import tracemalloc

import numpy as np
import pytest
from tests.ros.helpers import random_message

from armcell.core import InputError, UnknownNameError
from armcell.ros.codec import Codec, WireError, cdr_codec, ros1_codec
from armcell.ros.schema import Schema, schema

CODECS = [ros1_codec(), cdr_codec()]
IDS = ["ros1", "cdr"]
SHORT = schema().new("geometry_msgs/PoseWithCovariance", covariance=[1.0])  # needs 36


@pytest.mark.slow
def test_a_type_has_one_class_whichever_thread_asks_first():
    def classes():
        ready.wait()
        found.append([fresh.message(name) for name in fresh.messages])

    fresh, found, ready = Schema(), [], threading.Barrier(4)
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        threads = [threading.Thread(target=classes) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    finally:
        sys.setswitchinterval(before)
    assert len(found) == 4 and all(each == found[0] for each in found)


@pytest.mark.slow
@pytest.mark.parametrize("codec", CODECS, ids=IDS)
def test_every_type_comes_back_as_it_was(codec):
    rng = np.random.default_rng(5)
    for name in schema().messages:
        for message in (schema().new(name), random_message(schema(), name, rng)):
            data = codec.encode(message)
            back = codec.decode(name, data)
            _forget_seq(message, codec)
            assert back == message, name
            assert bytes(codec.encode(back)) == bytes(data), name


def _forget_seq(message, codec):
    """ROS 2's header has none."""
    if codec.name == "cdr":
        for field in message._fields:
            value = getattr(message, field)
            for item in value if isinstance(value, list) else [value]:
                if hasattr(item, "_fields"):
                    _forget_seq(item, codec)
        if message._type == "std_msgs/Header":
            message.seq = 0


def joint_state():
    return schema().new(
        "sensor_msgs/JointState",
        header=schema().new(
            "std_msgs/Header", seq=7, stamp=schema().new("builtin_interfaces/Time", 3, 500), frame_id="b"
        ),
        name=["ab", "c"],
        position=[0.5, -1.0],
    )


def test_ros1_bytes_by_hand():
    by_hand = struct.pack("<III", 7, 3, 500) + struct.pack("<I", 1) + b"b"
    by_hand += struct.pack("<II2sI1s", 2, 2, b"ab", 1, b"c")
    by_hand += struct.pack("<I2d", 2, 0.5, -1.0) + struct.pack("<II", 0, 0)
    assert bytes(ros1_codec().encode(joint_state())) == by_hand


def test_cdr_bytes_by_hand():
    """Alignment counts after the header; strings end in NUL; no seq; no padding for empty lists."""
    body = struct.pack("<iI", 3, 500) + struct.pack("<I", 2) + b"b\0" + b"\0\0"
    body += struct.pack("<I", 2) + struct.pack("<I", 3) + b"ab\0\0" + struct.pack("<I", 2) + b"c\0\0\0"
    body += struct.pack("<I", 2)
    body += b"\0" * (-len(body) % 8)
    body += struct.pack("<2d", 0.5, -1.0) + struct.pack("<II", 0, 0)
    assert bytes(cdr_codec().encode(joint_state())) == b"\0\1\0\0" + body


def test_unitys_empty_messages_have_no_byte():
    assert cdr_codec().decode("std_srvs/EmptyRequest", b"\0\1\0\0")._type == "std_srvs/EmptyRequest"
    assert bytes(cdr_codec().encode(schema().new("std_srvs/EmptyRequest"))) == b"\0\1\0\0\0"


def test_arrays_are_views_of_what_was_received():
    image = schema().new("sensor_msgs/Image", height=2, width=2, data=np.arange(4, dtype=np.uint8))
    data = bytes(ros1_codec().encode(image))
    back = ros1_codec().decode("sensor_msgs/Image", data)
    assert not back.data.flags.owndata and not back.data.flags.writeable


def test_lists_bytes_and_other_numbers_are_turned_into_the_wires_arrays():
    for position in (
        [1, 2],
        (1.0, 2.0),
        np.array([1, 2]),
        np.array([[1.0, 2.0]]),
        np.array([1, 9, 2, 9.0])[::2],
    ):
        message = schema().new("sensor_msgs/JointState", position=position)
        assert ros1_codec().decode(message._type, ros1_codec().encode(message)).position.tolist() == [
            1.0,
            2.0,
        ]
        assert message.position is position  # what the user holds stays as it is
    image = schema().new("sensor_msgs/Image", data=b"\1\2")
    assert ros1_codec().decode(image._type, ros1_codec().encode(image)).data.tolist() == [1, 2]


@pytest.mark.parametrize(
    ("name", "fields", "reason"),
    [
        ("sensor_msgs/Image", {"data": [300]}, "sensor_msgs/Image.data: int64 values do not fit uint8"),
        ("sensor_msgs/JointState", {"position": ["a"]}, "sensor_msgs/JointState.position"),
        ("sensor_msgs/JointState", {"name": [3]}, "cannot be encoded"),
        ("std_msgs/String", {"data": 3}, "data is 3, it should be like ''"),
        ("std_msgs/Float64", {"data": "3"}, "data is '3', it should be like 0.0"),
        ("std_msgs/UInt8", {"data": 256}, "cannot be encoded"),
        ("geometry_msgs/PoseStamped", {"pose": None}, "cannot be encoded"),
        ("nav_msgs/Odometry", {"pose": SHORT}, "length"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("codec", CODECS, ids=IDS)
def test_values_that_do_not_fit_are_misuse(codec, name, fields, reason):
    with pytest.raises(InputError, match=reason):
        codec.encode(schema().new(name, **fields))


@pytest.mark.parametrize("codec", CODECS, ids=IDS)
def test_cut_bytes_and_trailing_bytes_are_wire_errors(codec):
    rng = np.random.default_rng(3)
    for name in ("sensor_msgs/JointState", "moveit_msgs/PlanningScene", "tf2_msgs/TFMessage"):
        data = bytes(codec.encode(random_message(schema(), name, rng)))
        for cut in range(4, len(data) - 4, max(len(data) // 50, 1)):
            try:
                codec.decode(name, data[:cut])
            except WireError:
                continue
            pytest.fail(f"{cut} of {len(data)} bytes of {name} were taken")
        with pytest.raises(WireError):
            codec.decode(name, data + b"\0" * 9)


@pytest.mark.slow
@pytest.mark.parametrize("codec", CODECS, ids=IDS)
def test_random_bytes_give_a_message_or_a_wire_error(codec):
    rng = np.random.default_rng(9)
    names = schema().messages
    for _ in range(3000):
        data = rng.bytes(int(rng.integers(0, 80)))
        if codec.name == "cdr" and rng.random() < 0.8:
            data = b"\0\1\0\0" + data
        with contextlib.suppress(WireError):
            codec.decode(names[rng.integers(len(names))], data)


def test_a_length_of_four_billion_is_refused_at_once():
    huge = struct.pack("<III", 0, 0, 0) + struct.pack("<I", 0) + struct.pack("<I", 0xFFFFFFFF) + b"\0" * 40
    ros1_codec().prepare("sensor_msgs/JointState")
    ros1_codec().prepare("tf2_msgs/TFMessage")
    with most_memory() as peak:
        with pytest.raises(WireError):
            ros1_codec().decode("sensor_msgs/JointState", huge)
        with pytest.raises(WireError):
            ros1_codec().decode("tf2_msgs/TFMessage", struct.pack("<I", 0xFFFFFFFF))
    assert peak[0] < 1_000_000  # bytes


def test_invalid_utf8_is_a_wire_error():
    with pytest.raises(WireError):
        ros1_codec().decode("std_msgs/String", b"\2\0\0\0\xff\xfe")


def test_unknown_type():
    with pytest.raises(UnknownNameError):
        ros1_codec().decode("os/system", b"")


def test_empty_messages_in_a_list_cannot_take_for_ever(tmp_path):
    folder = tmp_path / "a_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Nothing.msg").write_text("")
    (folder / "Many.msg").write_text("Nothing[] items\n")
    codec = Codec("ros1", Schema(tmp_path))
    with pytest.raises(WireError):
        codec.decode("a_msgs/Many", b"\xff\xff\xff\xff")


@pytest.mark.parametrize("codec", CODECS, ids=IDS)
def test_big_messages_cost_no_more_than_their_copy(codec):
    """Encoding a cloud is one copy of its bytes; decoding none. In memory, as tracemalloc sees it."""
    data = np.zeros(307200 * 12, np.uint8)
    cloud = schema().new("sensor_msgs/PointCloud2", width=307200, point_step=12, data=data)
    encoded = codec.encode(cloud)
    with most_memory() as peak:
        codec.encode(cloud)
    assert data.nbytes <= peak[0] < 1.1 * data.nbytes
    with most_memory() as peak:
        codec.decode(cloud._type, encoded)
    assert peak[0] < 0.01 * data.nbytes


@contextlib.contextmanager
def most_memory():
    """In the first of a list of one, after the block: the most memory [bytes] it had taken at once."""
    peak = [0]
    tracemalloc.start()
    try:
        yield peak
        peak[0] = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_a_prepared_type_costs_nothing_extra_at_its_first_message(monkeypatch):
    codec = Codec("ros1", Schema())
    message = codec.schema.new("moveit_msgs/PlanningScene")
    codec.prepare("moveit_msgs/PlanningScene")
    monkeypatch.delattr("rosbags.typesys.store.generate_getsize_ros1")  # nothing is made any more
    codec.encode(message)
    with pytest.raises(UnknownNameError):
        codec.prepare("moveit_msgs/PlaningScene")
