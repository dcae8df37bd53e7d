"""The ROS-TCP server: damaged frames on real sockets, with a bystander who must not notice."""

from __future__ import annotations

import contextlib
import json
import select
import socket
import struct
from collections.abc import Iterator

from tests.fuzz.corpus import Corpus
from tests.fuzz.edges import Edges
from tests.ros.unity_like import UnityLike

from armcell.ros import Bus, cdr_codec, schema
from armcell.ros.codec import ros1_codec
from armcell.ros.tcp import RosTcpServer, ServerSettings
from armcell.ros.tcp.peer import Peer

TOPICS = ("/a", "/b", "joint_states", "/tf", "/chat", "", "a b")
TYPES = (
    "std_msgs/String", "sensor_msgs/JointState", "tf2_msgs/TFMessage", "trajectory_msgs/JointTrajectory",
    "moveit_msgs/PlanningScene", "std_srvs/SetBool", "std_srvs/Trigger", "nope/Nope",
)  # fmt: skip
COMMANDS = (
    "__subscribe", "__publish", "__ros_service", "__unity_service", "__topic_list", "__remove_subscriber",
    "__remove_publisher", "__remove_ros_service", "__remove_unity_service", "__request", "__response",
    "__ping", "__nothing",
)  # fmt: skip
OWN = ("/tf", "/bystander", "/chat")  # what stays on the bus when every client has gone
BATCHES, BATCH = 40, 20  # frames of one connection


class RosTcp:
    """One `send` is a connection that sends damaged frames until it is thrown out or has sent its share.

    Attributes:
        frames: handled by the server: what is left of a stream cut off does not count.
    """

    name = "ROS-TCP server"
    share = 0.6

    def __init__(self, seed: int, edges: Edges):
        self.corpus, self._edges, self.frames = Corpus(seed), edges, 0
        messages = [t for t in TYPES if t in schema().definitions]
        self._bodies = [
            bytes(codec.encode(self.corpus.message(name)))
            for codec in (ros1_codec(), cdr_codec())
            for name in [*messages, "std_srvs/SetBoolRequest"]
            for _ in range(5)
        ]

    @contextlib.contextmanager
    def opened(self) -> Iterator[None]:
        bus = Bus()
        _, response = schema().service("std_srvs/SetBool")
        bus.serve("/chat", "std_srvs/SetBool", lambda r: response(r.data, "ok"))
        bus.advertise("/tf", "tf2_msgs/TFMessage", latch=True).publish(schema().new("tf2_msgs/TFMessage"))
        handle = Peer.on_frame

        def on_frame(peer, frame):
            self.frames += 1
            before = self._edges.count
            handle(peer, frame)
            if self._edges.count > before and peer.address != self._bystander_address:
                self.corpus.keep((frame.destination.encode() + b"\0" * frame.terminated, frame.body))

        Peer.on_frame = on_frame
        try:
            with (
                RosTcpServer(bus, ServerSettings(port=0, service_timeout=0.01, queue=2)) as server,
                UnityLike(server.address, poll=0) as self._bystander,
                bus.subscribe("/bystander", "std_msgs/String") as self._got,
            ):
                self._server = server
                self._bystander_address = "{}:{}".format(*self._bystander.socket.getsockname())
                self._bystander.register("__publish", "/bystander", "std_msgs/String")
                yield
        finally:
            Peer.on_frame = handle
        left = [name for name in (*(t.name for t in bus.topics()), *bus.services()) if name not in OWN]
        assert not left, f"left on the bus by clients that are gone: {left}"

    def check(self) -> None:
        """The bystander's message arrives, whatever the others send."""
        text = schema().new("std_msgs/String", data=str(self.frames))
        self._bystander.message("/bystander", ros1_codec().encode(text))
        assert self._got.get(10) == text, "the bystander's message did not arrive"

    def send(self) -> None:
        ros2 = self.corpus.chance(0.5)
        with (
            socket.create_connection(self._server.address, timeout=10.0) as raw,
            contextlib.suppress(ConnectionError),  # thrown out: rightly so
        ):
            raw.sendall(bytes(8))
            for _ in range(BATCHES):
                raw.sendall(b"".join(self._frame(ros2) for _ in range(BATCH)))
                if select.select([raw], [], [], 0)[0] and not raw.recv(1 << 16):
                    return
            raw.shutdown(socket.SHUT_WR)
            while raw.recv(1 << 16):
                pass

    def _frame(self, ros2: bool) -> bytes:
        """Damage mostly stays within a frame: once the lengths are wrong, the rest of a stream is lost."""
        corpus, nul = self.corpus, b"\0" if ros2 else b""
        if corpus.kept and corpus.chance(0.3):
            name, body = corpus.pick(corpus.kept)
            body = corpus.damage(body)
        elif corpus.chance(0.5):
            name, body = corpus.pick(COMMANDS).encode() + nul, self._parameters() + nul
        else:
            name, body = corpus.pick(TOPICS).encode() + nul, corpus.pick(self._bodies)
        if corpus.chance(0.3):
            body = corpus.damage(body)
        if corpus.chance(0.005):
            name = corpus.damage(name)
        data = struct.pack("<I", len(name)) + name + struct.pack("<I", len(body)) + body
        return corpus.damage(data) if corpus.chance(0.002) else data

    def _parameters(self) -> bytes:
        corpus = self.corpus
        values = {
            "topic": corpus.pick(TOPICS), "message_name": corpus.pick(TYPES), "latch": corpus.chance(0.5),
            "srv_id": corpus.pick((0, 1, 1001, -1, 2**40, "1", None, True, 1.5)),
            "extra": [{}], "request_time": 1.0,
        }  # fmt: skip
        return json.dumps({k: v for k, v in values.items() if not corpus.chance(0.15)}).encode()
