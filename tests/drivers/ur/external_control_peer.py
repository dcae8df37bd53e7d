"""A client in the manner of UR's own driver, written by its published protocol.

UR's C++ client has no package that can be installed here (PyPI, Debian: none, 2026-11-22).

Source: UniversalRobots/Universal_Robots_Client_Library, doc/architecture (reverse interface, trajectory point
interface, script sender, script command interface).
"""

from __future__ import annotations

import socket
import struct
import threading
import time
from pathlib import Path

SCRIPT = Path(__file__).with_name("external_control_peer.script").read_text()
STOPPED, IDLE, SERVOJ, SPEEDJ, FORWARD, SPEEDL = -2, 0, 1, 2, 3, 4
MOVEJ, MOVEL, SPLINE = 0, 1, 51
CUBIC, QUINTIC = 1, 2
SUCCESS, CANCELLED, FAILURE = 0, 1, 2
NOOP = (0.0,) * 6


def fixed(values) -> list[int]:
    return [round(v * 1e6) for v in values]


class ExternalControlPeer:
    """The computer's four ports. `with` opens and closes them."""

    def __init__(self, host: str = "127.0.0.1"):
        names = ("sender", "reverse", "trajectory", "commands")
        self._listening = {name: socket.create_server((host, 0)) for name in names}
        self.ports = {n: s.getsockname()[1] for n, s in self._listening.items()}
        self.program = SCRIPT.replace("{{HOST}}", host)
        for name in ("reverse", "trajectory", "commands"):
            self.program = self.program.replace("{{" + name.upper() + "}}", str(self.ports[name]))
        self._links: dict[str, socket.socket] = {}

    def __enter__(self) -> ExternalControlPeer:
        threading.Thread(target=self._serve_program, daemon=True).start()
        return self

    def __exit__(self, *exc: object) -> None:
        for each in (*self._listening.values(), *self._links.values()):
            each.close()

    def _serve_program(self) -> None:
        while True:
            try:
                link, _ = self._listening["sender"].accept()
            except OSError:
                return
            if link.recv(64) == b"request_program\n":
                link.sendall(self.program.encode())
            self._links["sender"] = link  # UR's sender leaves the connection open as well

    def wait(self) -> None:
        """Until the robot's program has connected back."""
        for name in ("trajectory", "commands", "reverse"):
            self._listening[name].settimeout(10.0)
            self._links[name], _ = self._listening[name].accept()
            self._links[name].setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def write(self, mode: int, values=NOOP, timeout_ms: int = 500) -> None:
        """A reverse message: the robot's patience for the next one, six values, a control mode."""
        self._links["reverse"].sendall(struct.pack(">8i", timeout_ms, *fixed(values), mode))

    def keep(self, mode: int, values, seconds: float, timeout_ms: int = 500) -> None:
        """The same message again and again, as a driver does."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.write(mode, values, timeout_ms)
            time.sleep(0.01)

    def forward(self, points, timeout_ms: int = 2000) -> None:
        """Points (pos, vel, acc, seconds, spline or blend, type) to follow from now on."""
        message = struct.pack(">8i", timeout_ms, 1, len(points), 0, 0, 0, 0, FORWARD)
        self._links["reverse"].sendall(message)
        for q, v, a, seconds, how, kind in points:
            last = how if kind == SPLINE else round(how * 1e6)
            packed = struct.pack(">21i", *fixed(q), *fixed(v), *fixed(a), round(seconds * 1e6), last, kind)
            self._links["trajectory"].sendall(packed)

    def cancel(self) -> None:
        self._links["reverse"].sendall(struct.pack(">8i", 2000, -1, 0, 0, 0, 0, 0, FORWARD))

    def result(self, seconds: float) -> int:
        """Of a trajectory; meanwhile the robot is kept going."""
        link, end = self._links["trajectory"], time.monotonic() + seconds
        link.settimeout(0.05)
        while time.monotonic() < end:
            try:
                return struct.unpack(">i", link.recv(4))[0]
            except TimeoutError:
                self._links["reverse"].sendall(struct.pack(">8i", 2000, 0, 0, 0, 0, 0, 0, FORWARD))
        raise AssertionError("no result of the trajectory")

    def payload(self, mass: float) -> None:
        """A script command."""
        values = [1, *fixed([mass]), *[0] * 26]
        self._links["commands"].sendall(struct.pack(">28i", *values))
