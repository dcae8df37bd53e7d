"""Link to the worker process of one Franka arm, which reports states and results."""

from __future__ import annotations

import json
import socket
import struct
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.core import InputError
from armcell.drivers.execution_handle import RUNNING
from armcell.drivers.franka import worker_messages
from armcell.drivers.franka.settings import FrankaLimits
from armcell.drivers.franka.wire.commands import Command, WireError
from armcell.drivers.franka.wire.state import RobotState, read_state

Array = NDArray[np.float64]

WORKER = Path(__file__).with_name("worker_main.py")
START_TIME = 30.0  # [s] for the process to start, also on a busy machine
ANSWER_TIME = 10.0  # [s] for the robot's answer: a recovery takes a few seconds
KEPT = 512  # states
SEND_TIME = 1.0  # [s] in which a worker that lives reads an order
SILENCE = 1.0  # [s] without a state after which a worker counts as hung


def _timeval(seconds: float) -> bytes:
    return struct.pack("@ll", int(seconds), int(seconds % 1.0 * 1e6))


class WorkerConnection:
    """Connection to the worker process of one Franka arm: it starts the process and exchanges messages with
    it.

    Attributes:
        history: (receive time [s, monotonic], state) of recent states, oldest first.
        error: reason for which the connection ended, or None.
    """

    def __init__(
        self, name: str, host: str, watchdog: float, backend: str, limits: FrankaLimits,
        on_state: Callable[[], None],
    ):  # fmt: skip
        self._name, self._host, self._on_state = name, host, on_state
        self._options = str(watchdog), backend, json.dumps([limits.lower.tolist(), limits.upper.tolist()])
        self.history: deque[tuple[float, RobotState]] = deque(maxlen=KEPT)
        self.error: str | None = "not connected"
        self.progress = (0, 0.0)  # number of the motion and its clock [s]
        self._number = 0
        self._results: dict[int, str] = {}
        self._answers: dict[int, int] = {}
        self._asked = 0
        self._news = threading.Condition()
        self._sending = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._socket: socket.socket | None = None

    def start(self) -> None:
        """Start the worker process of a Franka arm and connect to it, then wait for the first robot state
        that the worker sends.

        Raises:
            InputError: the connection failed.
        """
        self.close()
        mine, theirs = socket.socketpair()
        mine.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, _timeval(SEND_TIME))
        command = [sys.executable, str(WORKER), str(theirs.fileno()), self._host]
        self._process = subprocess.Popen([*command, *self._options], pass_fds=[theirs.fileno()])
        theirs.close()
        self._socket, self.error = mine, None
        self.history.clear()
        self._answers.clear()
        self._reader = threading.Thread(
            target=self._read, args=(mine,), name=f"franka {self._name}", daemon=True
        )
        self._reader.start()
        with self._news:
            self._news.wait_for(lambda: self.history or self.error, START_TIME)
        if not self.history:
            reason = self.error or f"no state arrived within {START_TIME:g} s"
            self.close()
            raise InputError(
                f"arm {self._name!r}: {reason}", hint="activate FCI in Desk and end other clients"
            )

    def close(self) -> None:
        """Close the connection to the worker process of a Franka arm, and end the process. If the arm is
        moving, it stops.
        """
        process, self._process = self._process, None
        if process is None or self._socket is None:
            return
        self._order(do="end")
        self._socket.shutdown(socket.SHUT_WR)
        try:
            process.wait(2.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        self._reader.join(1.0)
        self._socket.close()
        self.error = self.error or "closed"

    def close_hung(self) -> None:
        """Close the connection to a hung worker of a Franka arm, which no longer sends robot states, so that
        `start` can replace the worker.

        A worker can hang when its library receives a damaged message.
        """
        if self.state_age > SILENCE:
            self.close()

    # --- messages ---
    def _send(self, data: bytes) -> None:
        with self._sending:
            if self._socket is None:  # a heartbeat before the first connection
                return
            try:
                self._socket.sendall(data)
            except OSError:
                self._lost("the worker process ended or does not react")

    def _order(self, **order: Any) -> None:
        self._send(worker_messages.pack_json(worker_messages.ORDER, order))

    def _lost(self, reason: str) -> None:
        with self._news:
            self.error = self.error or reason
            self._news.notify_all()

    def _read(self, sock: socket.socket) -> None:
        received = bytearray()
        while worker_messages.read_into(sock, received):
            while (message := worker_messages.take_message(received)) is not None:
                self._take(*message)
        self._lost("the worker process ended")
        self._on_state()

    def _take(self, kind: int, content: bytes) -> None:
        if kind == worker_messages.STATE:
            when, number, clock = worker_messages.PROGRESS.unpack_from(content)
            try:
                state = read_state(content[worker_messages.PROGRESS.size :])
            except WireError:
                return
            with self._news:
                self.history.append((when, state))
                self.progress = number, clock
                self._news.notify_all()
            self._on_state()
        elif kind == worker_messages.EVENT:
            self._event(json.loads(content))

    def _event(self, event: dict[str, Any]) -> None:
        with self._news:
            if "result" in event:
                self._results[event["number"]] = event["result"]
            elif "answer" in event:
                self._answers[event["answer"]] = event["status"]
            elif "failed" in event or "lost" in event:
                self.error = event.get("failed") or event.get("lost")
            self._news.notify_all()
        self._on_state()

    def ask(self, command: Command, payload: bytes = b"") -> int:
        """Send a command to the Franka robot over the connection to its worker process, and return the status
        in the robot's answer.

        Raises:
            InputError: no answer arrives.
        """
        with self._news:
            self._asked += 1
            number = self._asked
        self._order(do="ask", id=number, command=command.value, payload=payload.hex())
        with self._news:
            self._news.wait_for(lambda: number in self._answers or self.error, ANSWER_TIME)
            if number in self._answers:
                return self._answers.pop(number)
        raise InputError(
            f"arm {self._name!r}: {self.error or 'the robot does not answer'}", hint="look at Desk"
        )

    # --- orders ---
    def beat(self) -> None:
        self._order(do="beat")

    def set_speed_scaling(self, pace: float) -> None:
        self._order(do="pace", pace=pace)

    def play(self, rows: Array) -> int:
        """Send joint positions (n, 7) [rad], one per millisecond, over the connection to the worker of a
        Franka arm, which executes them as one motion. Return the number of the motion.
        """
        self._number += 1
        with self._news:
            self._results.clear()
            self._results[self._number] = RUNNING
        data = worker_messages.pack(worker_messages.ROWS, np.ascontiguousarray(rows, dtype="<f8").tobytes())
        self._send(
            data
            + worker_messages.pack_json(worker_messages.ORDER, {"do": "trajectory", "number": self._number})
        )
        return self._number

    def servo(self, q: Array, v: Array, at: float) -> None:
        self._order(do="point", at=at, q=q.tolist(), v=v.tolist())

    def cancel(self) -> None:
        self._order(do="cancel")

    def result(self, number: int) -> str:
        """Return the state of a motion, as received over the connection to the Franka worker: running, done,
        cancelled, or the reason why it failed.
        """
        return self._results.get(number, self.error or "cancelled")

    @property
    def state_age(self) -> float:
        """Return the age [s] of the latest robot state that arrived over the connection to the Franka
        worker.
        """
        return time.monotonic() - self.history[-1][0] if self.history else float("inf")
