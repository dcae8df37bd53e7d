"""Fuzzing the ROS-TCP server: mutated frames on real sockets, with a bystander who must not notice.

    python -m tests.ros.fuzz_tcp --frames 1000000 --seed 1        (make fuzz)

Frames are drawn from a grammar of valid ones and then damaged; those that made the server say or do
something new (a kind of `__error` not seen yet) are kept and damaged further.
"""

from __future__ import annotations

import argparse
import json
import logging
import re
import resource
import socket
import struct
import sys
import threading
import time
from dataclasses import dataclass, field

import numpy as np
from tests.ros.helpers import random_message
from tests.ros.unity_like import UnityLike

from armcell.ros import Bus, cdr, schema
from armcell.ros.codec import ros1
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
MAX_KEPT = 500
OWN = ("/tf", "/bystander", "/chat")  # what stays on the bus when every client has gone


@dataclass
class Report:
    """What a run has seen."""

    frames: int = 0  # handled by the server: what is left of a stream cut off does not count
    connections: int = 0
    kinds: set[str] = field(default_factory=set)
    crashes: list[str] = field(default_factory=list)
    bystander_messages: int = 0
    leaked_threads: int = 0
    leaked_topics: list[str] = field(default_factory=list)  # of clients that are gone
    peak_mib: tuple[float, float] = (0.0, 0.0)  # resident at a tenth of the run and at its end


class _Crashes(logging.Handler):
    """An exception that our code logs is a crash somebody has to look at."""

    def __init__(self, report: Report):
        super().__init__(logging.ERROR)
        self._report = report

    def emit(self, record):
        if record.exc_info:
            self._report.crashes.append(self.format(record))


class Grammar:
    """Draws frames, valid and damaged."""

    def __init__(self, seed: int):
        self.rng = np.random.default_rng(seed)
        self.kept: list[tuple[bytes, bytes]] = []
        messages = [t for t in TYPES if t in schema().definitions]
        self.bodies = [
            bytes(codec.encode(random_message(schema(), name, self.rng)))
            for codec in (ros1(), cdr())
            for name in [*messages, "std_srvs/SetBoolRequest"]
            for _ in range(5)
        ]

    def pick(self, items):
        return items[self.rng.integers(len(items))]

    def frame(self, ros2: bool) -> bytes:
        """Damage mostly stays within a frame: once the lengths are wrong, the rest of a stream is lost."""
        nul = b"\0" if ros2 else b""
        if self.kept and self.rng.random() < 0.2:
            name, body = self.pick(self.kept)
            body = self.damage(body)
        elif self.rng.random() < 0.5:
            name, body = self.pick(COMMANDS).encode() + nul, self.parameters() + nul
        else:
            name, body = self.pick(TOPICS).encode() + nul, self.pick(self.bodies)
        if self.rng.random() < 0.3:
            body = self.damage(body)
        if self.rng.random() < 0.03:
            name = self.damage(name)
        self.last = name, body
        data = struct.pack("<I", len(name)) + name + struct.pack("<I", len(body)) + body
        return self.damage(data) if self.rng.random() < 0.004 else data

    def parameters(self) -> bytes:
        values = {
            "topic": self.pick(TOPICS), "message_name": self.pick(TYPES), "latch": bool(self.rng.integers(2)),
            "srv_id": self.pick((0, 1, 1001, -1, 2**40, "1", None, True, 1.5)),
            "extra": [{}], "request_time": 1.0,
        }  # fmt: skip
        for key in list(values):
            if self.rng.random() < 0.15:
                del values[key]
        return json.dumps(values).encode()

    def damage(self, data: bytes) -> bytes:
        raw = bytearray(data)
        for _ in range(int(self.rng.integers(1, 4))):
            if not raw:
                break
            at = int(self.rng.integers(len(raw)))
            how = self.rng.integers(5)
            if how == 0:
                raw[at] ^= 1 << int(self.rng.integers(8))
            elif how == 1:
                del raw[at : at + int(self.rng.integers(1, 9))]
            elif how == 2:
                raw[at:at] = self.rng.bytes(int(self.rng.integers(1, 9)))
            elif how == 3:
                raw[at : at + 4] = struct.pack("<I", self.pick((0, 1, 2**31, 2**32 - 1, 65, 1 << 20)))
            else:
                raw[at] = int(self.rng.integers(256))
        return bytes(raw)


def fuzz(frames: int, seed: int, seconds: float = float("inf"), say=lambda text: None) -> Report:
    """Send damaged frames until `frames` are sent or `seconds` [s] have passed."""
    report, grammar = Report(), Grammar(seed)
    handler = _Crashes(report)
    log = logging.getLogger("armcell")
    log.addHandler(handler)
    before = threading.active_count()
    end, told = time.monotonic() + seconds, 0.0
    old_hook, old_on_frame = threading.excepthook, Peer.on_frame

    def on_frame(peer, frame):
        report.frames += 1
        old_on_frame(peer, frame)

    Peer.on_frame = on_frame
    threading.excepthook = lambda args: report.crashes.append(f"{args.thread}: {args.exc_value!r}")
    try:
        bus = Bus()
        _serve(bus)
        with (
            RosTcpServer(bus, ServerSettings(port=0, service_timeout=0.01, queue=2)) as server,
            UnityLike(server.address) as bystander,
        ):
            bystander.register("__publish", "/bystander", "std_msgs/String")
            got = bus.subscribe("/bystander", "std_msgs/String")
            while report.frames < frames and time.monotonic() < end and not report.crashes:
                _connection(server, grammar, report)
                _check(bystander, got, report)
                if not report.peak_mib[0] and report.frames >= frames // 10:
                    report.peak_mib = (_resident(), 0.0)
                if time.monotonic() > told + 5:
                    told = time.monotonic()
                    say(f"{report.frames} frames, {report.connections} connections, {_resident():.0f} MiB")
        report.peak_mib = (report.peak_mib[0], _resident())
        report.leaked_topics = [t.name for t in bus.topics() if t.name not in OWN]
        report.leaked_topics += [name for name in bus.services() if name not in OWN]
    finally:
        log.removeHandler(handler)
        threading.excepthook, Peer.on_frame = old_hook, old_on_frame
    wait = time.monotonic() + 5
    while threading.active_count() > before + 1 and time.monotonic() < wait:
        time.sleep(0.01)
    report.leaked_threads = max(threading.active_count() - before - 1, 0)  # the bystander's subscription
    return report


def _serve(bus: Bus) -> None:
    _, response = schema().service("std_srvs/SetBool")
    bus.serve("/chat", "std_srvs/SetBool", lambda r: response(r.data, "ok"))
    bus.advertise("/tf", "tf2_msgs/TFMessage", latch=True).publish(schema().new("tf2_msgs/TFMessage"))


def _connection(server: RosTcpServer, grammar: Grammar, report: Report) -> None:
    """One client that sends damaged frames until it is thrown out or has sent its share."""
    ros2 = bool(grammar.rng.integers(2))
    report.connections += 1
    with socket.create_connection(server.address, timeout=5.0) as raw:
        raw.sendall(bytes(8))
        try:
            for _ in range(40):
                batch, parts = [], []
                for _ in range(20):
                    batch.append(grammar.frame(ros2))
                    parts.append(grammar.last)
                raw.sendall(b"".join(batch))
                raw.settimeout(0.0005)
                try:
                    answer = raw.recv(1 << 16)
                except TimeoutError:
                    continue
                finally:
                    raw.settimeout(5.0)
                if not answer:
                    return
                kinds = {re.sub(rb"[0-9]+", b"#", k) for k in re.findall(rb'"text":"([^"]{0,60})', answer)}
                new = {k.decode(errors="replace") for k in kinds} - report.kinds
                if new and len(grammar.kept) < MAX_KEPT:
                    report.kinds |= new
                    grammar.kept += parts
        except OSError:
            return  # thrown out: rightly so


def _check(bystander: UnityLike, got, report: Report) -> None:
    text = schema().new("std_msgs/String", data=str(report.frames))
    bystander.message("/bystander", ros1().encode(text))
    answer = got.get(10)
    if answer is None or answer.data != text.data:
        report.crashes.append("the bystander's message did not arrive")
    report.bystander_messages += 1


def _resident() -> float:
    """[MiB]"""
    pages = int(open("/proc/self/statm").read().split()[1])  # noqa: SIM115
    return pages * resource.getpagesize() / 2**20


def main() -> int:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--frames", type=int, default=1_000_000)
    arguments.add_argument("--seed", type=int, default=int(time.time()))
    arguments.add_argument("--seconds", type=float, default=600.0)
    given = arguments.parse_args()
    logging.getLogger("armcell").setLevel(logging.ERROR)
    print(f"seed {given.seed}", flush=True)
    report = fuzz(given.frames, given.seed, given.seconds, lambda text: print(text, flush=True))
    print(f"{report.frames} frames, {report.connections} connections, {len(report.kinds)} kinds of answers")
    print(f"resident {report.peak_mib[0]:.0f} MiB at a tenth, {report.peak_mib[1]:.0f} MiB at the end")
    print(f"{report.leaked_threads} threads left over, {len(report.crashes)} crashes")
    for crash in report.crashes[:5]:
        print(crash)
    print(f"left on the bus: {report.leaked_topics or 'nothing'}")
    return 1 if report.crashes or report.leaked_threads or report.leaked_topics else 0


if __name__ == "__main__":
    sys.exit(main())
