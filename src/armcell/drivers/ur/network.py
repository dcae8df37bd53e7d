"""Network quality of a robot connection: round trips, and regularity of the robot's state."""

from __future__ import annotations

import time

import numpy as np

from armcell import _interrupts
from armcell.drivers.real import NetworkReport
from armcell.drivers.ur.dashboard import DashboardClient
from armcell.drivers.ur.rtde_client import RobotState, RtdeClient


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
