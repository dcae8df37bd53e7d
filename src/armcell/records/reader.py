"""Reader of a recorded run: states, events, plans, scenes and stage spans."""

from __future__ import annotations

import bisect
import json
import os
import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np
from mcap import records
from numpy.typing import NDArray

from armcell.core import SE3, Contact, Event, InputError, JointState, JointTrajectory, StateSample
from armcell.model.untrusted_files import BoundedReader
from armcell.records.mcap_writer import ABOUT, NANO, RESULT, object_of, typestore
from armcell.records.metadata import checked_metadata
from armcell.records.recorder import MCAP_FILE
from armcell.scene import PlanningScene

Array = NDArray[np.float64]

LARGEST_RECORD = 1 << 30  # [bytes] a larger length field means that the file is damaged
_JOINTS = ("/joint_states", "/joint_targets", "/gripper_states")


@dataclass(frozen=True, eq=False)
class RecordedJoints:
    """JointState message read from a record. Arrays are empty where values are unknown."""

    names: tuple[str, ...]
    positions: Array
    velocities: Array
    efforts: Array

    def as_state(self, time: float) -> JointState:
        v, effort = (x if len(x) else None for x in (self.velocities, self.efforts))
        return JointState(self.names, self.positions, v, effort, time)


@dataclass(frozen=True, eq=False)
class RecordedState:
    """State of the cell at one time, with exactly the values that the record contains."""

    nanoseconds: int  # time of the cell's clock
    joints: RecordedJoints
    targets: RecordedJoints | None = None
    grippers: RecordedJoints | None = None  # width [m] as position, force [N] as effort
    poses: Mapping[str, Array] = field(default_factory=dict)  # object -> x, y, z, qx, qy, qz, qw
    contacts: tuple[tuple[Any, ...], ...] = ()  # a, b, distance [m], x, y, z [m]

    @property
    def time(self) -> float:
        """Return the time [s] of the cell's clock for a state that was read from a record."""
        return self.nanoseconds / NANO

    def sample(self) -> StateSample:
        """Convert a recorded state to a `StateSample`, the form in which observers receive states."""
        t, g = self.time, self.grippers
        return StateSample(
            t,
            self.joints.as_state(t),
            {n: SE3.from_quat_xyzw(p[:3], p[3:]) for n, p in self.poses.items()},
            {} if g is None else dict(zip(g.names, g.positions.tolist())),
            {} if g is None else {n: f for n, f in zip(g.names, g.efforts.tolist()) if np.isfinite(f)},
            None if self.targets is None else self.targets.as_state(t),
            tuple(Contact(a, b, d, (x, y, z)) for a, b, d, x, y, z in self.contacts),
        )


@dataclass(frozen=True, eq=False)
class Record:
    """A recorded run, as read from its file.

    Attributes:
        metadata: run metadata, see `run_metadata`; empty if the record is not of a cell's task.
        result: result of the run; None if the record is incomplete or no result was written.
        cut: cause of an incomplete record; empty for a complete one.
    """

    file: Path
    metadata: Mapping[str, Any]
    result: Mapping[str, Any] | None
    cut: str
    states: tuple[RecordedState, ...]
    events: tuple[Event, ...]
    trajectories: tuple[tuple[float, JointTrajectory], ...]  # (start time [s], trajectory)
    images: int = 0  # number of camera images

    @property
    def duration(self) -> float:
        """Return the duration [s] of a record from its first to its last state, by the cell's clock."""
        return self.states[-1].time - self.states[0].time if self.states else 0.0

    def index_at(self, time: float) -> int:
        """Return the index of the last recorded state of a run at or before a given time [s]."""
        return max(bisect.bisect_right(self.states, round(time * NANO), key=lambda s: s.nanoseconds) - 1, 0)


def record_file(run: str | Path) -> Path:
    """Return the path of a run's record file. `run` is either the run folder that contains this file, or the
    file itself.

    Raises:
        InputError: there is no record.
    """
    path = Path(run)
    if os.path.isfile(path):
        return path
    for name in (MCAP_FILE, f"{MCAP_FILE}.part"):  # .part: the run was killed
        if os.path.isfile(path / name):
            return path / name
    reason = f"has no {MCAP_FILE}" if os.path.isdir(path) else "there is no such run"
    raise InputError(
        reason, file=path, hint="give a folder that `armcell run` made, such as runs/<time>-<cell>"
    )


def read_record(run: str | Path) -> Record:
    """Read the record of a run from a run folder or an MCAP file.

    Raises:
        InputError: no record, not an MCAP file, unsupported version, or cut off before the first state.
    """
    file = record_file(run)
    reading = _Reading(file)
    cut = reading.read()
    if not reading.states:
        raise InputError(
            "has no state in it" + (f": {cut}" if cut else ""), file=file,
            hint="a record begins when its run does: run the task again",
        )  # fmt: skip
    return Record(
        file, reading.metadata, reading.result, cut, tuple(reading.states), tuple(reading.events),
        tuple(reading.trajectories), reading.images,
    )  # fmt: skip


class _Reading:
    """Parser that assembles a record from the messages in its file."""

    def __init__(self, file: Path):
        self.file = file
        self.metadata: dict[str, Any] = {}
        self.result: dict[str, Any] | None = None
        self.states: list[RecordedState] = []
        self.events: list[Event] = []
        self.trajectories: list[tuple[float, JointTrajectory]] = []
        self.images = 0
        self._start: int | None = None  # [ns] start; without `metadata`, the time of the first message
        self._kinds: dict[int, str] = {}  # schema id -> message type
        self._channels: dict[int, Any] = {}
        self._parts: dict[str, Any] = {}  # messages of the state that is being read
        self._poses: dict[str, Array] = {}

    def read(self) -> str:
        """Read and parse the file of a record. Return a text that states where the file is cut off or
        damaged; the text is empty if the file is complete.
        """
        from mcap.exceptions import InvalidMagic, McapError
        from mcap.stream_reader import StreamReader
        from rosbags.serde.errors import SerdeError
        from zstandard import ZstdError

        damage = (McapError, SerdeError, ZstdError, struct.error, ValueError, KeyError, TypeError, IndexError)
        try:
            with self.file.open("rb") as stream:
                for record in StreamReader(
                    cast(Any, BoundedReader(stream)), validate_crcs=True, record_size_limit=LARGEST_RECORD
                ).records:
                    self._take(record)
        except InvalidMagic:
            if not self.states:
                raise InputError("is no MCAP file", file=self.file) from None
            return "its end is missing"
        except OSError as error:
            raise InputError(f"cannot be read: {error.strerror}", file=self.file) from None
        except InputError:
            raise
        except damage as error:
            last = f"{self.states[-1].time:.2f} s" if self.states else "its beginning"
            return f"it is cut off or damaged after {last} ({type(error).__name__})"
        return ""

    def _take(self, record: Any) -> None:
        match record:
            case records.Schema():
                self._kinds[record.id] = record.name
            case records.Channel():
                self._channels[record.id] = record
            case records.Metadata(name=name) if name == ABOUT:
                self.metadata = checked_metadata(json.loads(record.metadata["json"]), self.file)
                self._start = int(self.metadata["start_ns"])
            case records.Metadata(name=name) if name == RESULT:
                self.result = json.loads(record.metadata["json"])
            case records.Message():
                self._message(record)

    def _message(self, record: records.Message) -> None:
        channel = self._channels[record.channel_id]
        topic = channel.topic
        if self._start is None:
            self._start = record.log_time
        if topic == "/tf":
            self._end_state()
        elif topic.startswith("/camera/"):
            self.images += 1
        elif topic in _JOINTS:
            message = self._decoded(record, channel)
            self._parts[topic] = RecordedJoints(
                tuple(message.name), message.position, message.velocity, message.effort
            )
            if topic == "/joint_states":
                self._parts["at"] = self._nanoseconds(message.header.stamp)
        elif topic.startswith("/object_pose/"):
            name = channel.metadata.get("object", topic.rpartition("/")[2])
            self._poses[name] = _pose_row(self._decoded(record, channel).pose)
        elif topic == "/contacts":
            rows = json.loads(self._decoded(record, channel).data)
            self._parts[topic] = tuple(tuple(row) for row in rows)
        elif topic == "/events":
            event = json.loads(self._decoded(record, channel).data)
            self.events.append(Event(event["time"], event["kind"], event["text"], event["data"]))
        elif topic == "/planned_trajectory":
            message = self._decoded(record, channel)
            at = self._nanoseconds(message.header.stamp) / NANO
            self.trajectories.append((at, _trajectory(message)))

    def _end_state(self) -> None:
        parts, self._parts = self._parts, {}
        poses, self._poses = self._poses, {}
        if "/joint_states" in parts:
            goals, grippers = (parts.get(topic) for topic in _JOINTS[1:])
            touching = parts.get("/contacts", ())
            joints: RecordedJoints = parts["/joint_states"]
            self.states.append(RecordedState(parts["at"], joints, goals, grippers, poses, touching))

    def _decoded(self, record: records.Message, channel: records.Channel) -> Any:
        return typestore().deserialize_cdr(record.data, self._kinds[channel.schema_id])

    def _nanoseconds(self, stamp: Any) -> int:
        assert self._start is not None
        return stamp.sec * NANO + stamp.nanosec - self._start


def _pose_row(pose: Any) -> Array:
    p, q = pose.position, pose.orientation
    return np.array([p.x, p.y, p.z, q.x, q.y, q.z, q.w])


def _trajectory(message: Any) -> JointTrajectory:
    points, n = message.points, len(message.joint_names)
    times = [p.time_from_start.sec + p.time_from_start.nanosec / NANO for p in points]

    def rows(kind: str) -> Array | None:
        given = [getattr(p, kind) for p in points]
        return np.array(given).reshape(len(points), n) if all(len(g) == n for g in given) and n else None

    positions = rows("positions")
    return JointTrajectory(
        tuple(message.joint_names), np.array(times), np.zeros((0, n)) if positions is None else positions,
        rows("velocities"), rows("accelerations"),
    )  # fmt: skip


def scenes_of(record: Record, start: PlanningScene) -> list[tuple[float, PlanningScene]]:
    """Read the scenes of a recorded run with their times [s]:
    the scene at the start and the scene after each change.

    The robot and the movable objects keep their initial poses; the recorded states contain their motion.
    """
    found = [(record.states[0].time, start)]
    for event in record.events:
        if event.kind != "scene":
            continue
        scene, data = found[-1][1], event.data
        for name in data.get("removed", ()):
            if name in scene.objects:
                scene = scene.without_object(name)
        for name, entry in {**data.get("added", {}), **data.get("changed", {})}.items():
            item = object_of(name, entry)
            if item is not None:
                scene = scene.with_object(item)
        for name, pose in data.get("moved", {}).items():
            if name in scene.objects:
                scene = scene.with_object_pose(name, SE3.from_mapping(pose, "pose"))
        found.append((event.time, scene))
    return found


_ENDS = {"end", "ended", "done", "finished", "failed", "success"}


@dataclass(frozen=True)
class StageSpan:
    name: str
    begin: float  # [s]
    end: float  # [s]


def stage_name(event: Event) -> str:
    """Read the stage name from an event of a record: the entry `name` or `stage` of its data, or else the
    event's text.
    """
    return str(event.data.get("name") or event.data.get("stage") or event.text)


def ends_stage(event: Event) -> bool:
    """Return whether a stage event that was read from a record marks the end of the stage.

    The phase is `data["phase"]`, by default "begin".
    """
    return str(event.data.get("phase", "begin")).lower() in _ENDS


def stage_spans(events: Iterable[Event], until: float) -> list[StageSpan]:
    """Read the time spans of the stages from a recorded run, in time order.

    A stage ends with its end event, the start of the next stage or `until` [s], whichever comes first. Empty
    spans are omitted.
    """
    spans: list[StageSpan] = []
    name, begin = None, 0.0
    for event in sorted((e for e in events if e.kind == "stage"), key=lambda e: e.time):
        if name is not None:
            spans.append(StageSpan(name, begin, event.time))
        name, begin = (None, 0.0) if ends_stage(event) else (stage_name(event), event.time)
    if name is not None:
        spans.append(StageSpan(name, begin, until))
    return [s for s in spans if s.end - s.begin > 1e-6]
