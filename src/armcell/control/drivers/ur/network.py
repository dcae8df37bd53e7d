"""How good the network to a robot is: round trips and the regularity of its state."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from armcell import _interrupts
from armcell.control.drivers.ur.dashboard import DashboardClient
from armcell.control.drivers.ur.rtde_client import RobotState, RtdeClient


@dataclass(frozen=True)
class NetworkReport:
    """Times [s] over one measurement."""

    round_trip: float  # median, of a dashboard question
    worst_round_trip: float
    period: float  # median between states
    worst_gap: float  # longest between two states
    frequency: float  # asked for [Hz]

    def __str__(self) -> str:
        return (
            f"round trip {self.round_trip * 1000:.1f} ms (worst {self.worst_round_trip * 1000:.1f}), "
            f"state every {self.period * 1000:.1f} ms (worst gap {self.worst_gap * 1000:.1f})"
        )


def measure_network(host: str, frequency: float, seconds: float = 2.0) -> NetworkReport:
    """Listen to a robot for a while. Nothing moves.

    Raises:
        InputError: it does not answer.
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
