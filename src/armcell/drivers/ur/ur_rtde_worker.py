"""Subprocess for `ur_rtde`'s control interface, one per arm, because a lost link crashes it.

With a lost link, the library ends the process by SIGSEGV. The file runs as a script and needs only the
standard library and `ur_rtde`: `python ur_rtde_worker.py FD HOST FREQUENCY WATCHDOG STOP_DECELERATION`. FD
is a socket for lines of JSON in both directions. It receives: beat, trajectory, point, cancel, payload,
tcp, end. It sends: ready, then the progress in every cycle.
"""

from __future__ import annotations

import json
import socket
import sys
import threading
import time
from collections import deque
from itertools import pairwise
from typing import Any

LOOKAHEAD, GAIN = 0.03, 1000.0  # parameters of servoJ: [s], [1]
KEEP = 0.2  # [s] after the last streamed point before servoing ends
LONGEST_STEP = 2.5  # largest clock step in periods: the arm must not jump after a delay


class Worker:
    def __init__(self, link: socket.socket, host: str, frequency: float, watchdog: float, stop: float):
        from rtde_control import RTDEControlInterface

        self._link, self._watchdog, self._stop = link, watchdog, stop
        self._step = 1.0 / frequency
        self._control = RTDEControlInterface(host, frequency)
        self._control.setWatchdog(1.0 / watchdog)
        self._orders: deque[dict[str, Any]] = deque()
        self._points: deque[tuple[float, list[float], list[float]]] = deque(maxlen=64)
        self._beaten, self._scaling = time.monotonic(), 1.0
        self._open, self._servoing = True, False
        self._path: dict[str, Any] | None = None
        self._clock = 0.0
        self._number, self._result = 0, "done"

    def read(self) -> None:
        """Receive orders from armcell in the `ur_rtde` worker,
        until the socket closes or the order `end` arrives.
        """
        with self._link.makefile("rb") as lines:
            for line in lines:
                order = json.loads(line)
                if order["do"] == "beat":
                    self._beaten, self._scaling = time.monotonic(), order["scaling"]
                elif order["do"] == "point":
                    self._points.append((order["at"], order["q"], order["v"]))
                elif order["do"] == "end":
                    break
                else:
                    self._orders.append(order)
        self._open = False

    def run(self) -> None:
        self._say({"ready": True})
        threading.Thread(target=self.read, daemon=True).start()
        due = time.monotonic()
        last = due
        while self._open:
            now = time.monotonic()
            if now - self._beaten < self._watchdog:
                self._control.kickWatchdog()
            while self._orders:
                self._obey(self._orders.popleft())
            self._go_on(now, now - last)
            last = now
            self._say({"number": self._number, "result": self._result, "clock": self._clock})
            due = max(due + self._step, time.monotonic())
            time.sleep(max(due - time.monotonic(), 0.0))
        self._rest()
        self._control.stopScript()
        self._control.disconnect()

    def _say(self, message: dict[str, Any]) -> None:
        try:
            self._link.sendall(json.dumps(message).encode() + b"\n")
        except OSError:
            self._open = False

    def _obey(self, order: dict[str, Any]) -> None:
        match order["do"]:
            case "trajectory":
                self._rest()
                self._path, self._clock = order, 0.0
                self._number, self._result = order["number"], "running"
            case "cancel":
                if self._path is not None:
                    self._result = "cancelled"
                self._rest()
            case "payload":
                mass, *cog = order["values"]
                self._control.setPayload(mass, cog)
            case "tcp":
                self._control.setTcp(order["values"])

    def _rest(self) -> None:
        self._path = None
        self._points.clear()
        if self._servoing:
            self._servoing = False
            self._control.servoStop(self._stop)

    def _go_on(self, now: float, passed: float) -> None:
        if self._path is not None and self._scaling > 0.0:
            rows, step = self._path["q"], self._path["step"]
            self._clock = min(
                self._clock + min(passed, LONGEST_STEP * self._step) * self._scaling, (len(rows) - 1) * step
            )
            i = min(int(self._clock / step), len(rows) - 2)
            x = self._clock / step - i
            self._servo([a + x * (b - a) for a, b in zip(rows[i], rows[i + 1])])
            if self._clock >= (len(rows) - 1) * step and self._result == "running":
                settled = self._path.setdefault("settled", now)
                if now - settled > LOOKAHEAD + 4 * self._step:
                    self._rest()
                    self._result = "done"
        elif self._path is None and self._points:
            if now - self._points[-1][0] > KEEP:
                self._rest()
            elif self._scaling > 0.0:
                self._servo(interpolate(list(self._points), now))

    def _servo(self, q: list[float]) -> None:
        self._servoing = True
        if not self._control.servoJ(q, 0.0, 0.0, self._step, LOOKAHEAD, GAIN):
            self._servoing, self._path = False, None
            self._points.clear()
            self._result = "the robot does not take ur_rtde's targets"


def interpolate(points: list[tuple[float, list[float], list[float]]], now: float) -> list[float]:
    """Interpolate the points (time, position, speed) of a `ur_rtde`
    worker by cubic polynomials, and return the position.

    Before the first and after the last point, the position is the nearest point's.
    """
    if now <= points[0][0]:
        return points[0][1]
    for (t0, q0, v0), (t1, q1, v1) in pairwise(points):
        if t0 <= now < t1:
            h, x = t1 - t0, (now - t0) / (t1 - t0)
            a, b, c, d = (
                (1 + 2 * x) * (1 - x) ** 2,
                x * (1 - x) ** 2 * h,
                x * x * (3 - 2 * x),
                x * x * (x - 1) * h,
            )
            return [a * p0 + b * s0 + c * p1 + d * s1 for p0, s0, p1, s1 in zip(q0, v0, q1, v1)]
    return points[-1][1]


if __name__ == "__main__":
    descriptor, address, *numbers = sys.argv[1:]
    Worker(socket.socket(fileno=int(descriptor)), address, *map(float, numbers)).run()
