"""The MCAP reads back: values round trip, schemas are whole, times never go back."""

import json
import re
from collections import defaultdict
from dataclasses import replace

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from tests.records.synthetic import panda_scene, play

from armcell.core import SE3, Box, Event, JointState, JointTrajectory, StateSample
from armcell.kinematics import kinematic_tree
from armcell.model.urdf import parse_urdf
from armcell.records import RunRecorder
from armcell.records.mcap_writer import ros_name
from armcell.scene import CollisionObject

START_NS = 1_700_000_000_000_000_000
PRIMITIVES = {"bool", "byte", "char", "float32", "float64", "string"} | {
    f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)
}


@pytest.fixture(scope="module")
def scene():
    odd = [CollisionObject.single(n, Box(0.1, 0.1, 0.1), movable=True) for n in ("a b", "a-b", "9 lives")]
    scene = panda_scene()
    for item in odd:
        scene = scene.with_object(item)
    return scene


def read(file):
    """Messages by topic as (log time [ns], decoded), all in order, schemas by name, channels by topic."""
    store, by_topic, times, schemas, channels = get_typestore(Stores.EMPTY), defaultdict(list), [], {}, {}
    with file.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            if schema.name not in schemas:  # decoded with nothing but what the file itself says
                schemas[schema.name] = schema
                new = get_types_from_msg(schema.data.decode(), schema.name)
                store.register({k: v for k, v in new.items() if k not in store.fielddefs})
            channels[channel.topic] = channel
            times.append(message.log_time)
            by_topic[channel.topic].append(
                (message.log_time, store.deserialize_cdr(message.data, schema.name))
            )
    return by_topic, times, schemas, channels


@pytest.fixture(scope="module")
def recorded(scene, tmp_path_factory):
    with RunRecorder(tmp_path_factory.mktemp("run"), scene, START_NS) as recorder:
        play(scene, recorder, rate=100.0)
        recorder.on_event(Event(17.4, "contact", "ouch ✗", {"force": np.float64(2.5), "at": np.arange(3)}))
        name = {n: SE3.from_xyz(0, 0, i) for i, n in enumerate(("a b", "a-b", "9 lives"))}
        recorder.on_state(StateSample(17.5, JointState(("panda_joint2",), np.array([0.3])), name))
    return recorder, *read(recorder.mcap_file)


@pytest.mark.slow
def test_schemas_name_every_nested_type(recorded):
    schemas, channels = recorded[3], recorded[4]
    assert all(channel.message_encoding == "cdr" for channel in channels.values())
    for name, schema in schemas.items():
        assert schema.encoding == "ros2msg"
        first, *rest = re.split(r"^=+\nMSG: ", schema.data.decode(), flags=re.MULTILINE)
        defined = {section.partition("\n")[0].strip() for section in rest}
        for body in (first, *(section.partition("\n")[2] for section in rest)):
            for line in filter(None, (line.split("#")[0].strip() for line in body.splitlines())):
                kind = re.sub(r"\[.*\]|<=\d+", "", line.split()[0])
                assert kind in PRIMITIVES or kind in defined, (name, kind)


def test_times_are_monotonic_and_states_are_at_most_100_hz(recorded):
    _, topics, times, *_ = recorded
    assert times == sorted(times) and times[0] == START_NS
    stamps = np.array([t for t, _ in topics["/joint_states"]])
    assert len(stamps) > 1700
    assert np.diff(stamps[:-1]).min() >= 9_999_999
    for time, message in topics["/joint_states"]:
        assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == time


def test_joint_states_round_trip(recorded):
    recorder, topics, *_ = recorded
    series = recorder.series()
    assert len(topics["/joint_states"]) == len(series.times)
    for i in (0, 500, 1500):
        message = topics["/joint_states"][i][1]
        assert tuple(message.name) == series.joint_names
        np.testing.assert_array_equal(message.position, series.positions[i])
        np.testing.assert_array_equal(message.velocity, series.velocities[i])
        np.testing.assert_array_equal(message.effort, series.efforts[i])
    assert topics["/joint_states"][-1][1].name == ["panda_joint2"]


def test_transforms_chain_to_forward_kinematics(recorded, scene):
    recorder, topics, *_ = recorded
    series, tree = recorder.series(), kinematic_tree(scene.model)
    static = {t.child_frame_id: t for t in topics["/tf_static"][0][1].transforms}
    assert {"panda_link0", "wall", "floor"} <= set(static) and "cube" not in static
    for i in (3, 700):
        moving = {t.child_frame_id: t for t in topics["/tf"][i][1].transforms}
        assert not set(moving) & set(static)
        Ts = tree.link_transforms(series.positions[i])
        for link, T in zip(tree.link_names, Ts):
            assert chained({**static, **moving}, link).isclose(SE3.from_matrix(T), 1e-9, 1e-7), link
        np.testing.assert_allclose(
            chained({**static, **moving}, "cube").translation, series.object_positions["cube"][i]
        )


def chained(transforms, frame):
    T = SE3.identity()
    while frame != "world":
        step = transforms[frame]
        p, r = step.transform.translation, step.transform.rotation
        T = SE3.from_quat_xyzw((p.x, p.y, p.z), (r.x, r.y, r.z, r.w)) @ T
        frame = step.header.frame_id
    return T


def test_object_poses_round_trip_under_legal_names_of_their_own(recorded):
    recorder, topics, *_ = recorded
    series = recorder.series()
    pose = topics["/object_pose/cube"][700][1]
    assert pose.header.frame_id == "world"
    p, q = pose.pose.position, pose.pose.orientation
    np.testing.assert_array_equal([p.x, p.y, p.z], series.object_positions["cube"][700])
    np.testing.assert_array_equal([q.w, q.x, q.y, q.z], series.object_quats_wxyz["cube"][700])
    heights = {t: m[0][1].pose.position.z for t, m in topics.items() if t.startswith("/object_pose/")}
    assert heights["/object_pose/a_b"] == 0 and heights["/object_pose/a_b_"] == 1
    assert heights["/object_pose/_9_lives"] == 2


def test_trajectories_and_events_round_trip(recorded):
    recorder, topics, *_ = recorded
    assert len(topics["/planned_trajectory"]) == len(recorder.trajectories)
    sent, got = recorder.trajectories[1][1], topics["/planned_trajectory"][1][1]
    assert tuple(got.joint_names) == sent.joint_names
    np.testing.assert_array_equal([p.positions for p in got.points], sent.positions)
    times = [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in got.points]
    np.testing.assert_allclose(times, sent.times, atol=1e-9)
    events = [json.loads(m.data) for _, m in topics["/events"]]
    assert [e["text"] for e in events] == [e.text for e in recorder.events]
    assert events[-1]["data"] == {"force": 2.5, "at": [0, 1, 2]}


@pytest.mark.parametrize("in_memory", [np.ascontiguousarray, np.asfortranarray])
def test_velocities_and_accelerations_of_a_trajectory_are_kept(scene, tmp_path, in_memory):
    with RunRecorder(tmp_path, scene) as recorder:
        rows = in_memory(np.arange(6.0).reshape(3, 2))
        recorder.on_trajectory(
            2.5, JointTrajectory(("panda_joint1", "panda_joint2"), np.arange(3.0), rows, rows + 1, rows + 2)
        )
    message = read(recorder.mcap_file)[0]["/planned_trajectory"][0][1]
    np.testing.assert_array_equal([p.velocities for p in message.points], rows + 1)
    np.testing.assert_array_equal([p.accelerations for p in message.points], rows + 2)


def test_the_urdf_is_recorded(scene, recorded, tmp_path):
    urdf = tmp_path / "arm.urdf"
    urdf.write_text("<robot name='arm'/>")
    known = replace(scene, model=replace(scene.model, source=str(urdf)))
    with RunRecorder(tmp_path / "a", known) as recorder:
        pass
    assert read(recorder.mcap_file)[0]["/robot_description"][0][1].data == "<robot name='arm'/>"
    (_, text), *more = recorded[1]["/robot_description"]  # of a model without a file of its own
    again = parse_urdf(text.data, tmp_path / "record.urdf")
    q = scene.model.default_positions()
    assert not more and again.joint_names == scene.model.joint_names
    np.testing.assert_allclose(
        kinematic_tree(again).link_transforms(q), kinematic_tree(scene.model).link_transforms(q), atol=1e-6
    )


@pytest.mark.parametrize(
    ("name", "legal"), [("cube", "cube"), ("a b/c", "a_b_c"), ("1st", "_1st"), ("é", "_")]
)
def test_ros_names(name, legal):
    assert ros_name(name) == legal
