"""The decoders of ROS 1 and CDR, those of ROS 2's distributions among them: bytes that are no message.

What they take must be a message: it can be encoded, and what is encoded is taken again and says the same.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from tests.fuzz.corpus import Corpus
from tests.fuzz.edges import Edges

from armcell.ros import cdr_codec, schema
from armcell.ros.codec import WireError, ros1_codec
from armcell.ros.ros1 import sockets
from armcell.ros.ros2.codec import ros2_codec
from armcell.ros.ros2.dds import Sample
from armcell.ros.ros2.services import split

TYPES = (
    "std_msgs/String", "std_msgs/Header", "std_msgs/Empty", "sensor_msgs/JointState",
    "sensor_msgs/CameraInfo", "sensor_msgs/PointCloud2", "tf2_msgs/TFMessage",
    "trajectory_msgs/JointTrajectory",
    "control_msgs/FollowJointTrajectoryActionGoal", "moveit_msgs/PlanningScene",
    "moveit_msgs/CollisionObject", "moveit_msgs/GetMotionPlanRequest", "moveit_msgs/GetPositionIKRequest",
    "moveit_msgs/MoveGroupActionResult", "octomap_msgs/Octomap", "actionlib_msgs/GoalStatusArray",
    "visualization_msgs/MarkerArray",
)  # fmt: skip
ONLY_ROS2 = (
    "rmw_dds_common/ParticipantEntitiesInfo", "rcl_interfaces/SetParametersRequest",
    "action_msgs/CancelGoalRequest", "moveit_msgs/MoveGroup_SendGoal_Request",
    "control_msgs/FollowJointTrajectory_GetResult_Response",
)  # fmt: skip


class Decoders:
    """One `send` is one sequence of bytes, given to one decoder."""

    name = "decoders, ROS 1 and CDR"
    share = 0.25

    def __init__(self, seed: int, edges: Edges):
        self.corpus, self._edges, self.frames = Corpus(seed), edges, 0
        codecs = {
            "ros1": ros1_codec(), "cdr": cdr_codec(),
            **{d: ros2_codec(schema(), d) for d in ("humble", "jazzy")},
        }  # fmt: skip
        self._codecs = codecs
        self._seeds = [
            (codec, name, bytes(codecs[codec].encode(self.corpus.message(name))))
            for codec in codecs for name in TYPES for _ in range(3)
        ]  # fmt: skip
        for distro in ("humble", "jazzy"):
            codec = codecs[distro]
            self._seeds += [(distro, name, bytes(codec.encode(codec.new(name)))) for name in ONLY_ROS2]
        self._seeds += [
            ("TCPROS header", "", sockets.encode_header({"callerid": "/a", "md5sum": "*"})[4:])
        ] * 5
        self._seeds += [("ROS 2 call", "", bytes([0, 1, 0, 0]) + bytes(range(40)))]

    @contextlib.contextmanager
    def opened(self) -> Iterator[None]:
        yield

    def check(self) -> None:
        """Whole messages are taken."""
        codec, name, data = self.corpus.pick(self._seeds)
        self._take(codec, name, data)

    def send(self) -> None:
        corpus = self.corpus
        codec, name, data = corpus.pick(corpus.kept if corpus.kept and corpus.chance(0.5) else self._seeds)
        data = corpus.damage(data)
        self.frames += 1
        before = self._edges.count
        with contextlib.suppress(WireError):
            self._take(codec, name, data)
        if self._edges.count > before:
            corpus.keep((codec, name, data))

    def _take(self, codec: str, name: str, data: bytes) -> None:
        if codec == "TCPROS header":
            fields = sockets.decode_header(data)
            assert sockets.decode_header(sockets.encode_header(fields)[4:]) == {
                k.strip(): v for k, v in fields.items()
            }
        elif codec == "ROS 2 call":
            _, body = split(Sample(data, 0, 0))
            assert len(body) == len(data) - 16
        else:
            one = self._codecs[codec]
            encoded = bytes(one.encode(one.decode(name, data)))
            assert bytes(one.encode(one.decode(name, encoded))) == encoded, (
                f"{codec} {name}: says another thing"
            )
