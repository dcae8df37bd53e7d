"""Identity checks of a UR robot (model, serial number, calibration, readiness), and network quality.

The checks do not move the robot.
"""

from __future__ import annotations

import contextlib
import hashlib
import math
import socket
import struct
import threading
import time
from collections import deque
from dataclasses import dataclass

import numpy as np

from armcell import _interrupts
from armcell.core import InputError
from armcell.drivers.real import NetworkReport, check_serial_and_calibration
from armcell.drivers.ur.dashboard import DashboardClient
from armcell.drivers.ur.rtde_client import RobotState, RtdeClient
from armcell.drivers.ur.settings import UrArmSettings
from armcell.drivers.ur.wire import primary, rtde
from armcell.drivers.ur.wire.models import MODELS, UrModel, ur_model

EVERY = 0.02  # [s] between an answer and the next request

SHORTEST_OF = 5  # one late answer indicates a busy computer, five in a row the network


def measure_network(host: str, frequency: float, seconds: float = 2.0) -> NetworkReport:
    """Measure round trips and state intervals of the network connection to a UR robot,
    without moving the robot.

    Args:
        host: the robot's address.
        frequency: requested RTDE frequency [Hz].
        seconds: duration of the state measurement [s].
    Raises:
        InputError: the robot does not answer.
    """
    trips = []
    with DashboardClient(host) as dashboard:
        for _ in range(50):
            began = time.perf_counter()
            dashboard.ask("robotmode")
            trips.append(time.perf_counter() - began)
    stamps: list[float] = []

    def keep(state: RobotState) -> None:
        stamps.append(state.received)

    client = RtdeClient(host, frequency, on_state=keep)
    client.connect()
    _interrupts.sleep(seconds)
    client.close()
    gaps = np.diff(stamps) if len(stamps) > 2 else np.array([seconds])
    return NetworkReport(
        float(np.median(trips)), max(trips), float(np.median(gaps)), float(gaps.max()), frequency
    )


class Pinger:
    """Pinger that measures the network round trip to a UR robot with RTDE version requests.

    A controller always answers these requests, and they do not move the robot.
    """

    def __init__(self, host: str, port: int = rtde.PORT):
        self._address = (host, port)
        self._trips: deque[float] = deque(maxlen=SHORTEST_OF)
        self._asked: float | None = None
        self._open = False

    def start(self) -> None:
        """Connect the pinger to the UR controller, and start measuring round trips in a thread.

        Raises:
            OSError: no controller answers at this address.
        """
        self._socket = socket.create_connection(self._address, 3.0)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._open = True
        self._thread = threading.Thread(target=self._run, name=f"ping {self._address[0]}", daemon=True)
        self._thread.start()

    def round_trip_time(self) -> float:
        """Return the shortest of the last network round trips [s] that the pinger measured to a UR robot, or
        NaN before the first measurement.

        A pending request counts with its current age.
        """
        trips, asked = list(self._trips), self._asked
        if len(trips) < SHORTEST_OF:
            return math.nan
        under_way = [] if asked is None else [time.monotonic() - asked]
        return min(trips[1:] + under_way) if under_way and under_way[0] > trips[0] else min(trips)

    def _run(self) -> None:
        question, buffer = rtde.frame(rtde.CONTROLLER_VERSION, b""), bytearray()
        with contextlib.suppress(OSError, rtde.RtdeError):  # the driver detects a lost link
            while self._open:
                self._asked = began = time.monotonic()
                self._socket.sendall(question)
                while not any(kind == rtde.CONTROLLER_VERSION for kind, _ in rtde.frames(buffer)):
                    data = self._socket.recv(4096)
                    if not data:
                        return
                    buffer += data
                self._trips.append(time.monotonic() - began)
                self._asked = None
                time.sleep(EVERY)

    def close(self) -> None:
        self._open = False
        if hasattr(self, "_socket"):
            with contextlib.suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)
            self._socket.close()
            self._thread.join(timeout=1.0)


PRIMARY_PORT = 30001

NEAR = 0.02  # [m] largest difference of a calibrated geometry from its model; models differ by more


@dataclass(frozen=True)
class UrIdentity:
    """Identity and state of a UR robot, as its controller reports them."""

    host: str
    model: UrModel
    version: tuple[int, ...]
    serial: str
    geometry: primary.Kinematics
    remote: bool | None  # None: CB3 controllers have no remote control mode
    robot_mode: str
    safety: str

    def __str__(self) -> str:
        version = ".".join(map(str, self.version))
        return f"{self.model.name}, serial {self.serial}, calibration {self.calibration}, software {version}"

    @property
    def calibration(self) -> str:
        """Return a checksum of a UR robot's geometry, which identifies the robot and its calibration."""
        g = self.geometry
        data = struct.pack("<24d", *g.theta, *g.a, *g.d, *g.alpha)
        return hashlib.sha256(data).hexdigest()[:12]


def identify(host: str) -> UrIdentity:
    """Query the identity and state of a UR robot over its dashboard and primary interface.

    Raises:
        InputError: no robot answers, or its model is not supported.
    """
    with DashboardClient(host) as dashboard:
        version = dashboard.version()
        serial = dashboard.ask("get serial number")
        remote = dashboard.in_remote_control()
        mode, safety = dashboard.word("robotmode"), dashboard.word("safetymode")
    geometry = read_geometry(host)
    model, distance = min(
        ((m, geometry.difference(m.dh)[0]) for m in MODELS.values()), key=lambda pair: pair[1]
    )
    if distance > NEAR:
        raise InputError(
            f"the robot at {host} has the geometry of none of {', '.join(MODELS)} "
            f"(the nearest, {model.name}, is {distance * 1000:.0f} mm off)",
            hint="armcell drives these models only",
        )
    return UrIdentity(host, model, version, serial, geometry, remote, mode, safety)


def read_geometry(host: str, timeout: float = 3.0) -> primary.Kinematics:
    """Read a UR robot's Denavit-Hartenberg parameters from its primary interface. They identify the robot.

    Raises:
        InputError: the robot does not send its geometry.
    """
    buffer, end = bytearray(), time.monotonic() + timeout
    try:
        with socket.create_connection((host, PRIMARY_PORT), timeout) as link:
            while time.monotonic() < end:
                data = link.recv(65536)
                if not data:
                    break
                buffer += data
                for kind, body in primary.messages(buffer):
                    if kind == primary.ROBOT_STATE:
                        found = primary.packages(body).get(primary.KINEMATICS)
                        if found is not None:
                            return primary.Kinematics.unpack(found)
    except (OSError, ValueError, struct.error) as error:
        raise InputError(
            f"{host}:{PRIMARY_PORT} does not tell its geometry: {error}",
            hint="enable the primary client interface on the pendant (Settings, Security, Services)",
        ) from None
    raise InputError(f"{host}:{PRIMARY_PORT} did not tell its geometry within {timeout:g} s")


def check_identity(arm: str, wanted: UrArmSettings, found: UrIdentity) -> None:
    """Check the identity of a UR robot: its model,
    serial number and calibration must be those in the cell file.

    Raises:
        InputError: the robot is not the one in the cell file.
    """
    if found.model.name != ur_model(wanted.model).name:
        raise InputError(
            f"arm {arm!r}: the robot at {wanted.host} is a {found.model.name}, "
            f"the cell file says {wanted.model}",
            hint="correct 'model' (and the robot model of the cell), or the address",
        )
    check_serial_and_calibration(arm, wanted, found)


def check_ready(arm: str, found: UrIdentity) -> None:
    """Check, after a UR robot was identified, that it is in remote control, running and not stopped.

    Raises:
        InputError: the robot cannot be driven now; the message states the remedy.
    """
    if found.safety not in ("NORMAL", "REDUCED"):
        hint = {
            "PROTECTIVE_STOP": "look why, free the arm, then unlock it on the pendant or with "
            f"'armcell ur-dashboard {found.host} \"unlock protective stop\"'",
            "SAFEGUARD_STOP": "close the fence, reset the safeguard",
            "ROBOT_EMERGENCY_STOP": "release the emergency stop button, then power on",
            "SYSTEM_EMERGENCY_STOP": "release the emergency stop button, then power on",
        }.get(found.safety, "see the pendant")
        text = found.safety.lower().replace("_", " ")
        raise InputError(f"arm {arm!r}: the robot at {found.host} stands in {text}", hint=hint)
    if found.remote is False:
        raise InputError(
            f"arm {arm!r}: the robot at {found.host} is in local control",
            hint="on the pendant, top right: choose Remote Control (enable it first: Settings, System)",
        )
    if found.robot_mode != "RUNNING":
        raise InputError(
            f"arm {arm!r}: the robot at {found.host} is not running (mode {found.robot_mode})",
            hint="switch it on and release the brakes: on the pendant, or by 'armcell bringup'",
        )
