"""Network quality of a robot connection: round trips, also continuous, and the state's regularity."""

from __future__ import annotations

import contextlib
import math
import socket
import threading
import time
from collections import deque

import numpy as np

from armcell import _interrupts
from armcell.drivers.real import NetworkReport
from armcell.drivers.ur.dashboard import DashboardClient
from armcell.drivers.ur.rtde_client import RobotState, RtdeClient
from armcell.drivers.ur.wire import rtde

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
