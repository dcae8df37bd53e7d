"""A camera's subscribers do not slow a served cell: fast ones, slow ones, and one that never reads."""

from __future__ import annotations

import os
import pty
import re
import signal
import socket
import threading
import time
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import pytest
from tests.cli.helpers import start

from armcell.ros import Bus
from armcell.ros.tcp import ForwardedNames, RosTcpClient
from armcell.ros.tcp.framing import command

pytestmark = [pytest.mark.realtime, pytest.mark.slow]
TOPIC = "/overview/color/image_raw"  # 640 x 480, 30 Hz
LEAST_RATIO, LONGEST_GAP = 0.95, 0.1  # of simulated to wall time; [s] of /clock
SECONDS = 20.0


class Pace(NamedTuple):
    ratio: float
    gap: float  # [s]


class Served:
    """`armcell serve` as a process, its status line on a terminal, and a client of its /clock."""

    def __init__(self, *more: str, **environment: str):
        self._terminal, its = pty.openpty()
        self.status = ""
        env = {**os.environ, "COLUMNS": "300", "TERM": "xterm", **environment}
        self.process = start("serve", "panda_pick", "--unity", "--port", 0, *more, env=env, stderr=its)
        os.close(its)
        for pid in ("self", self.process.pid):  # as on a machine that has nothing else to do
            with suppress(OSError):
                Path(f"/proc/{pid}/autogroup").write_text("-15")
        threading.Thread(target=self._read_terminal, daemon=True).start()
        for line in self.process.stdout:
            if found := re.search(r"Unity can connect to \S+?:(\d+)", line):
                self.port = int(found[1])
                break
        self.times: list[tuple[float, float]] = []
        self.bus = Bus()
        bridge = ForwardedNames({}, {"/clock": "rosgraph_msgs/Clock"})
        self._client = RosTcpClient(self.bus, "127.0.0.1", self.port, bridge, "ROS1")
        self.bus.subscribe("/clock", "rosgraph_msgs/Clock", self._ticked, queue_size=1000)
        self._client.start()

    def _read_terminal(self) -> None:
        try:
            while data := os.read(self._terminal, 4096):
                self.status += data.decode("utf-8", "replace")
        except OSError:  # its other end is gone
            pass

    def _ticked(self, message) -> None:
        self.times.append((time.monotonic(), message.clock.to_sec()))

    def pace(self, seconds: float) -> Pace:
        first = len(self.times)
        time.sleep(seconds)
        got = self.times[first:]
        gaps = [b - a for (a, _), (b, _) in pairwise(got)]
        return Pace((got[-1][1] - got[0][1]) / (got[-1][0] - got[0][0]), max(gaps))

    def end(self) -> int:
        self._client.close()
        self.process.send_signal(signal.SIGINT)
        self.process.communicate(timeout=40)
        return self.process.returncode


def group_is_gone(process, seconds: float) -> bool:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        try:
            os.killpg(process.pid, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.05)
    return False


def keeps_pace(served: Served, alone: Pace, seconds: float = SECONDS) -> None:
    """As fast as alone; on a machine that has nothing else to do that is the wall's clock."""
    busy = os.getloadavg()[0] > 1.5 * (os.cpu_count() or 1)  # then a thread waits for a processor that long
    loaded = served.pace(seconds)
    print(f"alone {alone}, with a subscriber {loaded}")
    assert loaded.ratio >= LEAST_RATIO * alone.ratio, (alone, loaded)
    assert loaded.gap <= (5.0 if busy else 1.0) * LONGEST_GAP, (alone, loaded)


@pytest.mark.parametrize("backend", ["", "off"], ids=["opengl", "rays"])
def test_one_color_subscriber_does_not_slow_the_cell(backend):
    served = Served(**({"MUJOCO_GL": backend} if backend else {}))
    try:
        served.pace(3.0)
        alone = served.pace(5.0)
        camera = start("topic", "hz", TOPIC, "--connect", f"127.0.0.1:{served.port}")
        keeps_pace(served, alone)  # the renderer's start and the first picture count
        rates = [float(r) for r in re.findall(r"overview (\d+\.\d) frames/s", served.status)]
        assert rates and max(rates) > 0.0, served.status[-300:]
        print(f"frames/s as the status line has them: {rates}")
    finally:
        camera.kill()
        camera.communicate()
        status = served.end()
    assert status == 130 and group_is_gone(served.process, 5.0)


def test_a_subscriber_that_never_reads_does_not_slow_the_cell():
    served = Served()
    try:
        served.pace(3.0)
        alone = served.pace(5.0)
        with socket.create_connection(("127.0.0.1", served.port)) as silent:
            silent.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            for topic, kind in ((TOPIC, "Image"), ("/overview/depth/points", "PointCloud2")):
                silent.sendall(
                    command("__subscribe", {"topic": topic, "message_name": f"sensor_msgs/{kind}"})
                )
            keeps_pace(served, alone, 10.0)
    finally:
        assert served.end() == 130


def test_a_server_that_is_killed_leaves_no_renderer():
    served = Served()
    camera = start("topic", "hz", TOPIC, "--connect", f"127.0.0.1:{served.port}")
    try:
        end = time.monotonic() + 60
        while "frames/s" not in served.status and time.monotonic() < end:
            time.sleep(0.1)
        assert "frames/s" in served.status
    finally:
        camera.kill()
        camera.communicate()
        served.process.kill()
        served.process.communicate()
    assert group_is_gone(served.process, 10.0)
