"""What the ROS-TCP wire costs: latency, losses, and the answer time of a service in Unity.

    python benchmarks/wires.py --seconds 600 --beside 60 --json wires.json          (make bench-wires)

The server runs in this process, its clients in processes of their own, all over loopback. Times are the
wall clock's (a wire's latency is nothing else), taken when `publish` is called and when a client's
`recv` has returned the message's last byte; a loop is closed when what the client answers to a message of
the first topic is on the bus. At the end each number stands beside the bar it has to pass.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import resource
import struct
import sys
import threading
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.ros.unity_like import UnityLike

from armcell.ros import Bus, schema
from armcell.ros.tcp import RosTcpServer, ServerSettings
from armcell.ros.tcp.connection import OutboxLimits
from armcell.ros.tcp.framing import FrameReader

RATE = 30.0  # [Hz]
TOPICS = 100
STATE = "sensor_msgs/JointState"
IMAGE = "sensor_msgs/Image"
STAMP = "std_msgs/Time"


def reader(address, topics, types, seconds, results):
    """A client that notes (topic, seq, latency) of everything it gets, and answers the first topic."""
    unity = UnityLike(address, poll=0)
    unity.register("__publish", "/answer", STAMP)
    for topic, type_name in zip(topics, types):
        unity.register("__subscribe", topic, type_name)
    got = {topic: [] for topic in topics}
    frames, buffer = FrameReader(), bytearray(1 << 20)
    unity.socket.settimeout(0.2)
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        try:
            count = unity.socket.recv_into(buffer)
        except TimeoutError:
            continue
        now = time.monotonic_ns()
        if not count:
            break
        for frame in frames.feed(memoryview(buffer)[:count]):
            if frame.destination in got:
                seq, sec, nanosec = struct.unpack_from("<III", frame.body)
                got[frame.destination].append((seq, now - sec * 10**9 - nanosec))
                if frame.destination == topics[0]:
                    unity.message("/answer", struct.pack("<II", sec, nanosec))
    results.put(got)


def stalled(address, topics, types, seconds):
    """A client that asks for everything and reads nothing."""
    unity = UnityLike(address, poll=0)
    for topic, type_name in zip(topics, types):
        unity.register("__subscribe", topic, type_name)
    time.sleep(seconds)


def stamped(message, seq):
    now = time.monotonic_ns()
    message.header.seq = seq
    message.header.stamp = schema().new("builtin_interfaces/Time", *divmod(now, 10**9))
    return message


def run(seconds, images, with_stalled):
    """Publish 100 topics (and an RGB-D stream) at 30 Hz for a while; latencies and losses at one client."""
    bus = Bus()
    topics = [f"/joint_states_{i}" for i in range(TOPICS)]
    types = [STATE] * TOPICS
    if images:
        topics, types = [*topics, "/rgb", "/depth"], [*types, IMAGE, IMAGE]
    context = multiprocessing.get_context("spawn")
    results = context.Queue()
    with RosTcpServer(bus, ServerSettings(port=0)) as server:
        processes = [
            context.Process(target=reader, args=(server.address, topics, types, seconds + 8, results))
        ]
        if with_stalled:
            processes.append(
                context.Process(target=stalled, args=(server.address, topics, types, seconds + 8))
            )
        for process in processes:
            process.start()
        publishers = [bus.advertise(t, k) for t, k in zip(topics, types)]
        loops = []
        bus.attach("/answer", STAMP, lambda m: loops.append(time.monotonic_ns() - m.data.to_nsec()))
        while any(p.subscribers < len(processes) for p in publishers):
            time.sleep(0.01)
        names = [f"joint_{i}" for i in range(14)]
        rgb, depth = np.zeros(640 * 480 * 3, np.uint8), np.zeros(640 * 480 * 2, np.uint8)
        cpu, resident = time.process_time(), 0.0
        ticks, start = round(seconds * RATE), time.monotonic()
        for tick in range(ticks):
            time.sleep(max(start + tick / RATE - time.monotonic(), 0.0))
            for i, publisher in enumerate(publishers):
                if i < TOPICS:
                    message = schema().new(STATE, name=names, position=np.zeros(14), velocity=np.zeros(14))
                else:
                    message = schema().new(IMAGE, height=480, width=640, data=rgb if i == TOPICS else depth)
                publisher.publish(stamped(message, tick))
            if tick == ticks // 10:
                resident = resident_mib()
        cpu = (time.process_time() - cpu) / seconds
        grown = resident_mib() - resident
        dropped = sorted(c.dropped for c in server.clients())
        waiting = max(c.waiting_bytes for c in server.clients()) / 2**20
        got = results.get(timeout=60)
        for process in processes:
            process.join(timeout=30)
    states = [lat for t in topics[:TOPICS] for _, lat in got[t]]
    lost = sum(ticks - len({seq for seq, _ in got[t]}) for t in topics[:TOPICS])
    report = {
        "seconds": seconds,
        "messages": len(states),
        "lost": lost,
        "latency_median_ms": quantile(states, 0.5),
        "latency_p99_ms": quantile(states, 0.99),
        "latency_max_ms": max(states) / 1e6,
        "loop_median_ms": quantile(loops, 0.5),
        "loop_p99_ms": quantile(loops, 0.99),
        "server_cpu": round(cpu, 3),
        "resident_growth_mib": round(grown, 1),
        "waiting_mib": round(waiting, 1),  # at the client that is furthest behind
        "dropped_by_client": dropped,
    }
    if images:
        report["images"] = sum(len(got[t]) for t in topics[TOPICS:])
        report["images_lost"] = sum(ticks - len(got[t]) for t in topics[TOPICS:])
        report["image_latency_median_ms"] = quantile([v for t in topics[TOPICS:] for _, v in got[t]], 0.5)
    return report


def unity_service(calls):
    """Answer times of a service that a client polling as the connector does implements."""
    bus = Bus()
    request, _ = schema().service("std_srvs/Trigger")
    with RosTcpServer(bus, ServerSettings(port=0)) as server, UnityLike(server.address) as unity:
        unity.register("__unity_service", "/grip", "std_srvs/Trigger")
        bus.wait_for_service("/grip", 5)

        def answer():
            for _ in range(calls):
                asked = unity.read_until("__request")
                assert isinstance(asked, dict)
                name, _ = unity.read()
                unity.command("__response", srv_id=asked["srv_id"])
                unity.message(name, b"\x01\x00\x00\x00\x00")

        thread = threading.Thread(target=answer, daemon=True)
        thread.start()
        times = []
        for _ in range(calls):
            start = time.monotonic_ns()
            bus.call("/grip", request())
            times.append(time.monotonic_ns() - start)
    return {"calls": calls, "median_ms": quantile(times, 0.5), "p99_ms": quantile(times, 0.99)}


def quantile(values, q):
    return round(float(np.quantile(values, q)) / 1e6, 3)


def resident_mib():
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


def bars(report):
    """(what, measured, at most) of every number that issue 7 asks for."""
    alone, images = report["states"], report["states and RGB-D"]
    stalled = report["beside a stalled client"]
    cap = (
        2 * OutboxLimits().topic_bytes + TOPICS * ServerSettings().queue * 1024
    ) / 2**20  # two images, states of < 1 kB
    delays = [
        (f"{name}, {part}", round(run[part] - alone[part], 3), 5.0)
        for name, run in (("delayed by RGB-D", images), ("delayed by a stalled client", stalled))
        for part in ("latency_median_ms", "latency_p99_ms")
    ]
    return [
        ("lost in {:.0f} s [messages]".format(alone["seconds"]), alone["lost"], 0),
        ("latency, median [ms]", alone["latency_median_ms"], 1.0),
        ("latency, 99 % [ms]", alone["latency_p99_ms"], 5.0),
        *delays,
        ("lost beside RGB-D [messages]", images["lost"], 0),
        ("lost beside a stalled client [messages]", stalled["lost"], 0),
        ("waits for the stalled client [MiB]", stalled["waiting_mib"], cap),
        ("memory grown beside it [MiB]", stalled["resident_growth_mib"], cap),
        ("service in Unity, median [ms]", report["service in Unity"]["median_ms"], 12.0),
    ]


def main():
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--seconds", type=float, default=600.0, help="of the states alone")
    arguments.add_argument("--beside", type=float, default=60.0, help="beside images, and a stalled client")
    arguments.add_argument("--json", type=Path)
    given = arguments.parse_args()
    load = os.getloadavg()[0]
    report = {"load_before": load, "cpus": os.cpu_count(), "python": sys.version.split()[0]}
    for name, seconds, images, with_stalled in (
        ("states", given.seconds, False, False), ("states and RGB-D", given.beside, True, False),
        ("beside a stalled client", given.beside, True, True),
    ):  # fmt: skip
        report[name] = run(seconds, images, with_stalled)
        print(name, json.dumps(report[name]), flush=True)
    report["service in Unity"] = unity_service(200)
    print("service in Unity", json.dumps(report["service in Unity"]), flush=True)
    print(f"load before {load:.1f}, after {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    for what, measured, most in bars(report):
        print(f"{what:55} {measured:10.3f}  at most {most:g}{'' if measured <= most else '  MISSED'}")
    if given.json:
        given.json.write_text(json.dumps(report, indent=2) + "\n")


if __name__ == "__main__":
    main()
