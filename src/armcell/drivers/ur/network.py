"""Network quality of a robot connection: round trips and the regularity of its state."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from armcell import _interrupts
from armcell.drivers.ur.dashboard import DashboardClient
from armcell.drivers.ur.rtde_client import RobotState, RtdeClient


@dataclass(frozen=True)
class NetworkReport:
    """Statistics of one network measurement; times in [s]."""

    round_trip: float  # median of a dashboard request
    worst_round_trip: float
    period: float  # median interval between states
    worst_gap: float  # longest interval between two states
    frequency: float  # requested [Hz]

    def __str__(self) -> str:
        return (
            f"round trip {self.round_trip * 1000:.1f} ms (worst {self.worst_round_trip * 1000:.1f}), "
            f"state every {self.period * 1000:.1f} ms (worst gap {self.worst_gap * 1000:.1f})"
        )


def measure_network(host: str, frequency: float, seconds: float = 2.0) -> NetworkReport:
    """Measure round trips and state intervals of a robot connection, without moving the robot.

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
