"""MCAP writer for runs, with ROS 2 messages for Foxglove and `ros2 bag`, and the JSON form of objects.

Topics: /joint_states, /joint_targets (commanded positions), /gripper_states (width as position, force as
effort), /contacts (JSON in a String), /tf, /tf_static, /object_pose/<name>, /planned_trajectory, /events
(JSON in a String), /camera/<name>/compressed if requested, /robot_description and the topics of
`SceneMarkers`. Frames: "world" is the root; the robot's links follow its kinematic tree, objects are
direct children. The /tf message is the last message of a state. MCAP metadata: "armcell.run" describes
the run, "armcell.result" its result. Objects that are added to a scene during a run are written as JSON.
"""

from __future__ import annotations

import json
import logging
import re
import time
from collections.abc import Mapping
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np
from mcap.writer import CompressionType, Writer
from numpy.typing import ArrayLike, NDArray
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from armcell.core import (
    SE3,
    SO3,
    Contact,
    Event,
    JointState,
    JointTrajectory,
    Mesh,
    Shape,
    StateSample,
    make_shape,
    shape_kind,
    shape_name,
    shapes,
)
from armcell.kinematics import kinematic_tree
from armcell.model.urdf_writer import urdf_of
from armcell.records.scene_markers import CONTACTS, LINKS, MARKER_TYPES, OBJECTS, SCENE_UPDATE, SceneMarkers
from armcell.records.write_behind import WriteBehindFile
from armcell.scene import WORLD, CollisionObject, PlanningScene

Array = NDArray[np.float64]
logger = logging.getLogger(__name__)
PROFILE = "ros2"
STORE = Stores.ROS2_HUMBLE
NANO = 1_000_000_000
_CHUNK_BYTES = 128 * 1024  # maximum data loss of a killed process: about half a second
_LATCHED_QOS = (
    # transient local: delivered to late subscribers
    "- history: 1\n  depth: 1\n  reliability: 1\n  durability: 1\n"
)
_MAX_URDF_BYTES = 4_000_000


def pose_data(T: SE3) -> dict[str, Any]:
    return {"xyz": T.translation.tolist(), "quat_xyzw": T.quat_xyzw.tolist()}


def object_data(item: CollisionObject) -> dict[str, Any]:
    """Convert the shapes and properties of a scene object to the JSON data that the MCAP writer stores.

    Point clouds and octrees are stored by name only, because they are large and may arrive ten times a
    second.
    """
    return {
        "shapes": [{**_shape_data(shape), "pose": pose_data(T)} for shape, T in item.shapes],
        "pose": pose_data(item.T_world_object),
        "color": [float(c) for c in item.color],
        "movable": item.movable,
    }


def object_of(name: str, data: dict[str, Any]) -> CollisionObject | None:
    """Create a scene object from the JSON data that the MCAP writer stored. Return None if the data contain
    no shapes for the object.
    """
    shapes = [
        (shape, SE3.from_mapping(each["pose"], "pose"))
        for each in data["shapes"]
        if (shape := _shape_of(each)) is not None
    ]
    if not shapes:
        return None
    pose = SE3.from_mapping(data["pose"], "pose")
    return CollisionObject(name, tuple(shapes), pose, color=tuple(data["color"]), movable=data["movable"])


def _shape_data(shape: Shape) -> dict[str, Any]:
    kind = shape_kind(shape)
    if kind is None and isinstance(shape, Mesh):
        return {"mesh": {"vertices": shape.vertices.tolist(), "faces": shape.faces.tolist()}}
    return {shape_name(shape): [] if kind is None else kind.values(shape)}


def _shape_of(data: dict[str, Any]) -> Shape | None:
    if "mesh" in data:
        return Mesh(np.array(data["mesh"]["vertices"], float), np.array(data["mesh"]["faces"], int))
    return next((make_shape(name, sizes) for name, sizes in data.items() if name in shapes), None)


ABOUT, RESULT = "armcell.run", "armcell.result"


@cache
def typestore() -> Any:
    """Return the ROS message definitions that the writer of MCAP files uses."""
    store = get_typestore(STORE)
    for name, text in MARKER_TYPES:
        store.register(get_types_from_msg(text, name))
    return store


def schema_text(message_type: str) -> str:
    """Return a message definition for the MCAP file with all nested definitions, in the `ros2msg`
    encoding.
    """
    return typestore().generate_msgdef(message_type, ros_version=2)[0]


def ros_name(name: str) -> str:
    """Convert a name to a legal part of a ROS topic name, for the MCAP file.

    The segment contains letters, digits and underscores and does not begin with a digit.
    """
    legal = re.sub(r"[^A-Za-z0-9_]", "_", name)
    return f"_{legal}" if not legal or legal[0].isdigit() else legal


class McapWriter:
    """Writer for the MCAP file of one run. The file has a temporary name until `close`.

    Args:
        file: final path of the record.
        scene: scene with the robot and objects; fixed objects become static transforms.
        start_ns: time of cell time 0 in nanoseconds since 1970; now by default.
        metadata: run metadata, see `run_metadata`; written first, so that incomplete records contain it.
    """

    def __init__(
        self,
        file: Path,
        scene: PlanningScene,
        start_ns: int | None = None,
        metadata: Mapping[str, Any] | None = None,
    ):
        self.file = Path(file)
        self.start_ns = time.time_ns() if start_ns is None else start_ns
        self._part = self.file.with_name(self.file.name + ".part")
        self._scene = scene
        self._tree = kinematic_tree(scene.model)
        self._types = typestore().types
        self._markers = SceneMarkers(self._types, scene.model, scene.objects)
        self._last_ns = 0  # log times never decrease, even if the cell's clock is reset
        self._closed = False
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._topics: dict[str, str] = {}  # object name -> topic
        self._touching = False
        self._stream = WriteBehindFile(self._part)  # a slow disk must not delay a motion
        self._writer = Writer(cast("BinaryIO", self._stream), _CHUNK_BYTES, CompressionType.ZSTD)
        self._writer.start(profile=PROFILE, library="armcell")
        if metadata is not None:
            self._write_json(ABOUT, {**metadata, "start_ns": self.start_ns})
        joints = list(scene.model.joints.values())
        self._moving = [i for i, joint in enumerate(joints) if joint.movable]
        self._ends = [(joint.parent, joint.child) for joint in joints]
        self._write_static()
        self._stream.wait()  # raise disk errors before the robot moves

    # --- recording ---
    def write_state(self, sample: StateSample, q: ArrayLike) -> None:
        """Write the state of the cell at one time to the MCAP file,
        with the link transforms for joint positions q (dof,).
        """
        time, object_poses = sample.time, sample.object_poses
        stamp = self._stamp(time)
        self._write_joints("/joint_states", time, sample.joints)
        if sample.targets is not None:
            self._write_joints("/joint_targets", time, sample.targets)
        if sample.gripper_width:
            names = tuple(sample.gripper_width)
            force = [sample.gripper_force.get(n, np.nan) for n in names]
            self._write_named("/gripper_states", time, names, list(sample.gripper_width.values()), (), force)
        if sample.contacts or self._touching:
            self._touching = bool(sample.contacts)
            rows = [[c.body_a, c.body_b, c.distance, *c.position] for c in sample.contacts]
            self._write("/contacts", "std_msgs/msg/String", time, data=json.dumps(rows))
        self._write_markers(CONTACTS, time, self._markers.contacts(stamp, time, sample.contacts))
        self._write_markers(OBJECTS, time, self._markers.objects(stamp, time, object_poses))
        transforms = self._link_transforms(q, self._moving, stamp)
        for name, T in object_poses.items():
            transform, pose = self._both(T)
            transforms.append(self._transform(stamp, WORLD, name, transform))
            self._write(
                self._object_topic(name),
                "geometry_msgs/msg/PoseStamped",
                time,
                metadata={"object": name},
                header=self._header(stamp, WORLD),
                pose=pose,
            )
        self._write("/tf", "tf2_msgs/msg/TFMessage", time, transforms=transforms)
        self._stream.flush()  # write complete chunks to the disk

    def _write_markers(self, topic: str, time: float, update: Any | None) -> None:
        if update is not None:
            self._write_message(topic, SCENE_UPDATE, time, update, latched=topic != CONTACTS)

    def _write_joints(self, topic: str, time: float, state: JointState) -> None:
        v, effort = ((() if x is None else x) for x in (state.velocities, state.efforts))
        self._write_named(topic, time, state.joint_names, state.positions, v, effort)

    def _write_named(
        self, topic: str, time: float, names: tuple[str, ...], position: ArrayLike, velocity: ArrayLike,
        effort: ArrayLike,
    ) -> None:  # fmt: skip
        p, v, e = (np.asarray(x, dtype=float) for x in (position, velocity, effort))
        header = self._header(self._stamp(time), "")
        self._write(
            topic, "sensor_msgs/msg/JointState", time,
            header=header, name=list(names), position=p, velocity=v, effort=e,
        )  # fmt: skip

    def write_image(self, camera: str, time: float, png: bytes) -> None:
        """Write a camera image, given as PNG data, to the MCAP file."""
        header = self._header(self._stamp(time), camera)
        data = np.frombuffer(png, dtype=np.uint8)
        topic, kind = f"/camera/{ros_name(camera)}/compressed", "sensor_msgs/msg/CompressedImage"
        self._write(topic, kind, time, header=header, format="png", data=data)

    def write_result(self, result: Mapping[str, Any]) -> None:
        """Write the run's result."""
        self._write_json(RESULT, result)

    def _write_json(self, name: str, data: Mapping[str, Any]) -> None:
        self._writer.add_metadata(name, {"json": json.dumps(data, default=_plain, ensure_ascii=False)})
        self._stream.flush()

    def write_event(self, event: Event) -> None:
        record = {"time": event.time, "kind": event.kind, "text": event.text, "data": event.data}
        text = json.dumps(record, default=_plain, ensure_ascii=False)
        self._write("/events", "std_msgs/msg/String", event.time, data=text)
        if event.kind == "scene":
            self._markers.change(event.data)

    def write_trajectory(self, time: float, trajectory: JointTrajectory) -> None:
        Point = self._type("trajectory_msgs/msg/JointTrajectoryPoint")
        Duration = self._type("builtin_interfaces/msg/Duration")
        empty = np.zeros(0)
        # Messages need contiguous rows; trajectories assembled by joint may be stored column-wise.
        q, v, a = (
            None if rows is None else np.ascontiguousarray(rows, dtype=float)
            for rows in (trajectory.positions, trajectory.velocities, trajectory.accelerations)
        )
        assert q is not None
        points = []
        for i, at in enumerate(trajectory.times):
            sec, nanosec = divmod(round(float(at) * NANO), NANO)
            points.append(
                Point(
                    positions=q[i],
                    velocities=empty if v is None else v[i],
                    accelerations=empty if a is None else a[i],
                    effort=empty,
                    time_from_start=Duration(sec=sec, nanosec=nanosec),
                )
            )
        self._write(
            "/planned_trajectory",
            "trajectory_msgs/msg/JointTrajectory",
            time,
            header=self._header(self._stamp(time), WORLD),
            joint_names=list(trajectory.joint_names),
            points=points,
        )

    def close(self) -> None:
        """Finish the MCAP file and rename it to its final name. Repeated calls have no effect."""
        if self._closed:
            return
        self._closed = True
        try:
            self._writer.finish()
        finally:
            self._stream.close()
        self._part.replace(self.file)

    def __enter__(self) -> McapWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # --- how ---
    def _write_static(self) -> None:
        scene, stamp = self._scene, self._stamp(0.0)
        fixed = [i for i in range(len(self._ends)) if i not in set(self._moving)]
        transforms = self._link_transforms(scene.positions, fixed, stamp)
        roots = {} if scene.model.root_link == WORLD else {scene.model.root_link: SE3.identity()}
        still = {name: o.T_world_object for name, o in scene.objects.items() if not o.movable}
        for name, T in {**roots, **still}.items():
            transforms.append(self._transform(stamp, WORLD, name, self._both(T)[0]))
        self._write("/tf_static", "tf2_msgs/msg/TFMessage", 0.0, latched=True, transforms=transforms)
        urdf = urdf_text(scene) or urdf_of(scene.model)
        self._write("/robot_description", "std_msgs/msg/String", 0.0, latched=True, data=urdf)
        self._write_markers(LINKS, 0.0, self._markers.links(stamp))

    def _write(
        self,
        topic: str,
        message_type: str,
        time: float,
        latched: bool = False,
        metadata: dict[str, str] | None = None,
        **fields: Any,
    ) -> None:
        self._write_message(topic, message_type, time, self._type(message_type)(**fields), latched, metadata)

    def _write_message(
        self, topic: str, message_type: str, time: float, message: Any, latched: bool = False,
        metadata: dict[str, str] | None = None,
    ) -> None:  # fmt: skip
        data = typestore().serialize_cdr(message, message_type)
        now = max(self._nanoseconds(time), self._last_ns)
        self._last_ns = now
        channel = self._channel(topic, message_type, latched, metadata or {})
        self._writer.add_message(channel, now, bytes(data), now)

    def _channel(self, topic: str, message_type: str, latched: bool, metadata: dict[str, str]) -> int:
        if topic not in self._channels:
            if message_type not in self._schemas:
                text = schema_text(message_type).encode()
                self._schemas[message_type] = self._writer.register_schema(message_type, "ros2msg", text)
            metadata = {**metadata, **({"offered_qos_profiles": _LATCHED_QOS} if latched else {})}
            self._channels[topic] = self._writer.register_channel(
                topic, "cdr", self._schemas[message_type], metadata
            )
        return self._channels[topic]

    def _object_topic(self, name: str) -> str:
        if name not in self._topics:
            topic = f"/object_pose/{ros_name(name)}"
            while topic in self._topics.values():  # "a b" and "a-b" must not share a topic
                topic += "_"
            self._topics[name] = topic
        return self._topics[name]

    def _link_transforms(self, q: ArrayLike, joints: list[int], stamp: Any) -> list[Any]:
        """Convert the link transforms (parent to child) at joint positions q
        (dof,) to TransformStamped messages for the MCAP file.
        """
        Ts = self._tree.link_transforms(q)
        found = []
        for i in joints:
            P, C = Ts[self._tree.parent[i]], Ts[i + 1]
            R = P[:3, :3].T
            T = SE3(SO3(R @ C[:3, :3]), R @ (C[:3, 3] - P[:3, 3]))
            found.append(self._transform(stamp, *self._ends[i], self._both(T)[0]))
        return found

    def _both(self, T: SE3) -> tuple[Any, Any]:
        """Convert a transform to a Transform and a Pose of geometry_msgs, for the MCAP file."""
        x, y, z = T.translation.tolist()
        qw, qx, qy, qz = T.quat_wxyz.tolist()
        rotation = self._type("geometry_msgs/msg/Quaternion")(x=qx, y=qy, z=qz, w=qw)
        transform = self._type("geometry_msgs/msg/Transform")(
            self._type("geometry_msgs/msg/Vector3")(x, y, z), rotation
        )
        return transform, self._type("geometry_msgs/msg/Pose")(
            self._type("geometry_msgs/msg/Point")(x, y, z), rotation
        )

    def _transform(self, stamp: Any, parent: str, child: str, transform: Any) -> Any:
        return self._type("geometry_msgs/msg/TransformStamped")(self._header(stamp, parent), child, transform)

    def _header(self, stamp: Any, frame: str) -> Any:
        return self._type("std_msgs/msg/Header")(stamp, frame)

    def _stamp(self, time: float) -> Any:
        sec, nanosec = divmod(self._nanoseconds(time), NANO)
        return self._type("builtin_interfaces/msg/Time")(sec, nanosec)

    def _nanoseconds(self, time: float) -> int:
        return self.start_ns + round(time * NANO)

    def _type(self, name: str) -> Any:
        return self._types[name]


def urdf_text(scene: PlanningScene) -> str | None:
    """Return the robot's URDF as text for the MCAP file, or None if there is no URDF file or it is
    too large.
    """
    source = scene.model.source
    if not source.endswith(".urdf"):
        return None
    path = Path(source)
    try:
        return path.read_text(encoding="utf-8") if path.stat().st_size <= _MAX_URDF_BYTES else None
    except (OSError, UnicodeDecodeError):
        return None


def _plain(value: Any) -> Any:
    """Replace values that JSON does not support, so that the data can be written to the MCAP file.

    Arrays and numpy numbers become lists and numbers; objects, contacts, poses and mappings become
    dictionaries; other values become text.
    """
    if isinstance(value, CollisionObject):
        return object_data(value)
    if isinstance(value, SE3):
        return pose_data(value)
    if isinstance(value, Contact):
        return asdict(value)
    if isinstance(value, Mapping):
        return dict(value)
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else str(value)
