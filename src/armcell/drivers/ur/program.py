"""armcell's robot program for UR arms: URScript text, server for its connection, messages."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files

import numpy as np
from numpy.typing import ArrayLike

from armcell.core import ArmcellError, InputError, JointTrajectory

SCALE = 1_000_000
KEEP_ALIVE, SERVO, TRAJECTORY, CANCEL, PAYLOAD, TCP, TOOL_OUT, STANDARD_OUT, END = range(9)
RUNNING, DONE, CANCELLED = "running", "done", "cancelled"
_RESULTS = {0: DONE, 1: CANCELLED, 2: "starved of points", 3: "faster than a joint can be"}
ROOM = 32  # capacity of the program's point buffer: covers more than `stream_lead`
STAMP = 100_000  # ticks per second of a setpoint's time on the program's clock
_COMMAND, _SERVO, _POINT = struct.Struct(">8i24x"), struct.Struct(">14i"), struct.Struct(">20i")
SCRIPT_PORT = 30002


@dataclass(frozen=True)
class ProgramSettings:
    """Constants that armcell's robot program on a UR arm receives when it starts."""

    watchdog: float = 0.1  # [s] without a command before a moving arm stops itself
    idle_watchdog: float = 2.0  # [s] for an arm at rest, where a busy computer is not dangerous
    stop_deceleration: float = 15.0  # [rad/s^2] of the program's stops


def program_text(host: str, port: int, session: int, settings: ProgramSettings) -> str:
    """Return the URScript text of armcell's robot program, in which all placeholders are filled in."""
    text = (files("armcell.drivers.ur") / "armcell.script").read_text(encoding="utf-8")
    values = {
        "HOST": host, "PORT": port, "SESSION": session, "WATCHDOG": settings.watchdog,
        "IDLE_WATCHDOG": settings.idle_watchdog,
        "ROOM": ROOM, "ROOM_FOR_POINTS": ",".join(["0"] * ROOM * 13),
        "STOP_DECELERATION": settings.stop_deceleration,
    }  # fmt: skip
    for name, value in values.items():
        text = text.replace("{{" + name + "}}", str(value))
    return text


def trajectory_messages(trajectory: JointTrajectory, step: float, number: int) -> list[bytes]:
    """Encode all points of a trajectory except the first as messages for armcell's robot program on a UR arm.

    Points are at least two steps apart; nearer points are omitted. The robot interpolates between the points
    by quintics from the trajectory's positions, velocities and accelerations.

    Args:
        step: control period [s].
        number: trajectory number, stored in every point.
    """
    times = trajectory.times - trajectory.times[0]
    kept, last = [], 0.0
    for t in times[1:-1]:
        if t - last >= 2.0 * step and times[-1] - t >= 2.0 * step:
            kept.append(float(t))
            last = float(t)
    kept.append(float(times[-1]))
    messages, before = [], 0
    for t in kept:
        q, v, a = trajectory.sample(float(trajectory.times[0]) + t)
        stamp = round(t * SCALE)
        values = [round(float(x) * SCALE) for x in (*q, *v, *a)]
        messages.append(_POINT.pack(*values, stamp - before, number))
        before = stamp
    return messages


class ProgramConnection:
    """Connection from this computer to armcell's robot program.
    It uploads the program and sends commands to it.

    Args:
        arm: arm name, for messages.
        robot: the robot's address.
        port: port to listen on; every arm needs its own.
        own_host: this computer's address as seen from the robot; None: determined by the upload.
    """

    def __init__(self, arm: str, robot: str, port: int, own_host: str | None, settings: ProgramSettings):
        self._arm, self._robot, self._own_host, self._settings = arm, robot, own_host, settings
        self._server = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._server.bind((own_host or "", port))
        except OSError as error:
            self._server.close()
            raise InputError(
                f"arm {arm!r}: port {port} for the robot's connection is not free ({error.strerror})",
                hint="another arm or another armcell uses it: give each arm its own 'port' in the cell file",
            ) from None
        self._server.listen(4)
        self._reverse: socket.socket | None = None
        self._points: socket.socket | None = None
        self._sending = threading.Lock()
        self.result = DONE  # result of the last trajectory
        self._session, self._number = 0, 0

    @property
    def connected(self) -> bool:
        return self._reverse is not None

    def start(self, timeout: float = 5.0) -> int:
        """Upload armcell's robot program to the UR arm and wait until the program connects. Return the
        session number.

        Raises:
            InputError: the program did not connect; the message states possible causes.
        """
        self.close_links()
        self._session += 1
        port = self._server.getsockname()[1]
        try:
            with socket.create_connection((self._robot, SCRIPT_PORT), 3.0) as upload:
                host = self._own_host or upload.getsockname()[0]
                upload.sendall(program_text(host, port, self._session, self._settings).encode())
                found = self._accept(timeout)
        except OSError as error:
            raise InputError(
                f"arm {self._arm!r}: the program could not be sent to {self._robot}:{SCRIPT_PORT} ({error})",
                hint="check the address; e-Series: remote control must be on",
            ) from None
        if set(found) != {1, 2}:
            for link in found.values():
                link.close()
            raise InputError(
                f"arm {self._arm!r}: the program on {self._robot} did not connect back to {host}:{port} "
                f"within {timeout:g} s",
                hint=f"let port {port} through this computer's firewall; give 'own_host', the address the "
                "robot can reach; look at the pendant's log",
            )
        self._reverse, self._points = found[1], found[2]
        threading.Thread(
            target=self._results, args=(found[2],), name=f"points {self._arm}", daemon=True
        ).start()
        return self._session

    def _accept(self, timeout: float) -> dict[int, socket.socket]:
        found: dict[int, socket.socket] = {}
        end = time.monotonic() + timeout
        while set(found) != {1, 2} and (left := end - time.monotonic()) > 0:
            self._server.settimeout(left)
            try:
                link, (peer, _) = self._server.accept()
                link.settimeout(1.0)
                number = struct.unpack(">i", _exactly(link, 4))[0]
            except (TimeoutError, ArmcellError):
                continue
            if peer == self._robot or peer.startswith("127."):
                link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                found[number] = link
            else:
                link.close()
        return found

    def _results(self, link: socket.socket) -> None:
        """Receive the results of trajectories from armcell's robot
        program (URScript) until the program ends.
        """
        link.settimeout(None)
        try:
            while True:
                number, result = divmod(struct.unpack(">i", _exactly(link, 4))[0], 10)
                if number == self._number:
                    self.result = _RESULTS.get(result, "failed")
        except (OSError, ArmcellError):
            if link is self._points:
                self._forget()

    def send(self, kind: int, values: Sequence[float] = (), last: int = 0) -> None:
        """Send a command with up to six values to armcell's URScript program.
        Without a running program, nothing is sent.
        """
        six = [round(float(v) * SCALE) for v in values] + [0] * (6 - len(values))
        self._send(self._reverse, _COMMAND.pack(kind, *six, last))

    def servo(self, q: ArrayLike, v: ArrayLike, at: float) -> None:
        """Send a setpoint to armcell's URScript program:
        positions and speeds to be reached at a time [s] on the program's clock.
        """
        values = (round(float(x) * SCALE) for x in (*np.asarray(q), *np.asarray(v)))
        self._send(self._reverse, _SERVO.pack(SERVO, *values, round(at * STAMP)))

    def forward(self, trajectory: JointTrajectory, step: float) -> int:
        """Start a trajectory in armcell's URScript program.
        Return the number under which `result` reports it.
        """
        self._number = self._number % 1000 + 1
        points = trajectory_messages(trajectory, step, self._number)
        self.result = RUNNING
        self.send(TRAJECTORY, (self._number,), len(points))
        self._send(self._points, b"".join(points))
        return self._number

    def _send(self, link: socket.socket | None, data: bytes) -> None:
        if link is None:
            return
        try:
            with self._sending:
                link.sendall(data)
        except OSError:
            self._forget()

    def _forget(self) -> None:
        self._reverse = self._points = None
        if self.result == RUNNING:
            self.result = CANCELLED

    def close_links(self) -> None:
        for link in (self._reverse, self._points):
            if link is not None:
                with contextlib.suppress(OSError):  # the robot may have closed it first
                    link.shutdown(socket.SHUT_RDWR)
                link.close()
        self._forget()

    def close(self) -> None:
        self.close_links()
        self._server.close()


def _exactly(link: socket.socket, count: int) -> bytes:
    data = b""
    while len(data) < count:
        part = link.recv(count - len(data))
        if not part:
            raise ArmcellError("closed")
        data += part
    return data
