"""RTDE client, which receives the robot's state and sends input values."""

from __future__ import annotations

import contextlib
import selectors
import socket
import struct
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from armcell import _interrupts
from armcell.core import InputError
from armcell.drivers.ur.wire import rtde

STATE_VARIABLES = (
    "timestamp", "actual_q", "actual_qd", "target_q", "target_qd", "actual_current", "actual_TCP_pose",
    "actual_TCP_force", "robot_mode", "safety_mode", "safety_status_bits", "runtime_state",
    "speed_scaling", "target_speed_fraction", "actual_digital_input_bits", "actual_digital_output_bits",
    "output_int_register_24", "output_int_register_25", "output_double_register_24",
    "output_double_register_25", "output_int_register_26", "tcp_offset",
)  # fmt: skip

LOOK = 0.01  # [s] longest time between two checks for new packets
HISTORY = 0.2  # [s] length of the state history
MAX_SLEW = 0.05  # limit on the increase of the clock offset [s/s]
LOST = 0.05  # [s] increase beyond which the offset jumps


@dataclass(frozen=True)
class RobotState:
    """State of a UR robot that the RTDE client received in one packet: the values by RTDE variable name, and
    the arrival time.
    """

    values: dict[str, Any]
    received: float  # [s]

    def __getattr__(self, name: str) -> Any:
        try:
            return self.values[name]
        except KeyError:
            raise AttributeError(name) from None


class RobotClock:
    """Clock estimate of the RTDE client: the offset between the clock of a UR robot and the monotonic clock
    of this computer.

    Packets arrive late by the delay of the network and both computers, never early. The smallest difference
    between arrival time and time stamp in the last second is therefore the best estimate, and the clocks of
    several robots are known on this computer to a fraction of their period.
    """

    def __init__(self, window: int):
        self._seen: deque[float] = deque(maxlen=window)
        self.offset = 0.0  # [s] this computer's monotonic clock minus the robot's clock
        self._last = 0.0

    def update(self, stamp: float, received: float) -> None:
        """Update the clock offset of a UR robot with the time stamp and arrival time [s] of a packet that the
        RTDE client received.
        """
        first = not self._seen
        self._seen.append(received - stamp)
        least = min(self._seen)
        risen = self.offset + MAX_SLEW * max(stamp - self._last, 0.0)
        lost = least > self.offset + LOST  # an emulator on a busy machine paused
        self.offset = least if first or lost else min(least, risen)
        self._last = stamp


class RtdeClient:
    """RTDE client, which connects to a UR robot and receives its states in a thread.

    Args:
        host: the robot's address.
        frequency: requested rate of the state packets [Hz].
        inputs: variable names of each input recipe.
        on_state: called from the receiver thread with every new state.
    """

    def __init__(
        self, host: str, frequency: float, inputs: Sequence[Sequence[str]] = (),
        on_state: Callable[[RobotState], None] | None = None, port: int = rtde.PORT,
    ):  # fmt: skip
        self.host, self.frequency = host, frequency
        self._port, self._inputs, self._on_state = port, inputs, on_state
        self.latest: RobotState | None = None
        self.last_two: tuple[RobotState, RobotState] | None = None  # replaced atomically
        self.history: deque[RobotState] = deque(maxlen=max(round(HISTORY * frequency), 2))
        self.clock = RobotClock(round(frequency))
        self.error: str | None = None  # reason for which the connection ended
        self._buffer = bytearray()
        self._recipes: list[rtde.Recipe] = []
        self._sending = threading.Lock()

    def connect(self, timeout: float = 3.0) -> None:
        """Connect the RTDE client: negotiate with the UR robot, start the transmission,
        and wait for the first state.

        Raises:
            InputError: no RTDE server answers, or another client holds one of the inputs.
        """
        try:
            self._socket = socket.create_connection((self.host, self._port), timeout)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._negotiate()
        except (OSError, struct.error, rtde.RtdeError) as error:
            raise InputError(
                f"no RTDE at {self.host}:{self._port}: {error}",
                hint="check the address; on the pendant: Settings, Security, Services: enable RTDE",
            ) from None
        self._socket.settimeout(1.0)
        self._open = True
        self._looked = time.monotonic()
        self._thread = threading.Thread(target=self._receive, name=f"rtde {self.host}", daemon=True)
        self._thread.start()
        end = time.monotonic() + timeout
        while self.latest is None and self.error is None and time.monotonic() < end:
            _interrupts.sleep(0.005)
        if self.latest is None:
            raise InputError(f"{self.host} sends no RTDE data ({self.error or 'silence'})", hint="restart it")

    def _negotiate(self) -> None:
        if self._ask(rtde.VERSION, struct.pack(">H", 2)) != b"\x01":
            raise rtde.RtdeError("protocol version 2 was refused")
        answer = self._ask(
            rtde.SETUP_OUTPUTS, struct.pack(">d", self.frequency) + ",".join(STATE_VARIABLES).encode()
        )
        types = answer[1:].decode().split(",")
        missing = [n for n, t in zip(STATE_VARIABLES, types) if t == "NOT_FOUND"]
        if missing:
            raise rtde.RtdeError(f"the controller does not know {', '.join(missing)}: update its software")
        self._output_id, self._output = answer[0], rtde.Recipe(STATE_VARIABLES, types)
        for names in self._inputs:
            answer = self._ask(rtde.SETUP_INPUTS, ",".join(names).encode())
            kinds = answer[1:].decode().split(",")
            if answer[0] == 0:
                bad = ", ".join(f"{n} ({k})" for n, k in zip(names, kinds) if k in ("IN_USE", "NOT_FOUND"))
                raise rtde.RtdeError(f"inputs refused: {bad}; another RTDE client or a fieldbus holds them")
            self._recipes.append(rtde.Recipe(names, kinds))
        if self._ask(rtde.START, b"") != b"\x01":
            raise rtde.RtdeError("the controller did not start to send")

    def _ask(self, kind: int, payload: bytes) -> bytes:
        self._socket.sendall(rtde.frame(kind, payload))
        while True:
            for answer, body in rtde.frames(self._buffer):
                if answer == kind:
                    return body
            self._fill()

    def _fill(self) -> None:
        data = self._socket.recv(65536)
        if not data:
            raise rtde.RtdeError("the robot closed the connection")
        self._buffer += data

    def _receive(self) -> None:
        waiting = selectors.DefaultSelector()
        try:
            waiting.register(self._socket, selectors.EVENT_READ)
            while self._open:
                newest: RobotState | None = None
                for kind, body in rtde.frames(self._buffer):
                    if kind == rtde.DATA and body[:1] == bytes([self._output_id]):
                        newest = RobotState(self._output.unpack(body[1:]), time.monotonic())
                        self.clock.update(newest.timestamp, newest.received)
                        self.last_two = (self.last_two or (newest, newest))[1], newest
                        self.history.append(newest)
                if newest is not None:
                    self.latest = newest
                    if self._on_state is not None:
                        self._on_state(newest)
                    self._looked = newest.received
                if waiting.select(LOOK):
                    self._fill()
                else:
                    self._looked = time.monotonic()  # no packet has arrived
        except (OSError, ValueError, rtde.RtdeError, struct.error) as error:
            self.error = str(error) or type(error).__name__
        finally:
            waiting.close()

    @property
    def state_age(self) -> float:
        """Return how old [s] the latest state was when the RTDE client last checked for packets.

        The age uses the robot's time stamp: a packet that waited in a buffer is not new.
        """
        if self.latest is None:
            return float("inf")
        return max(self._looked - self.latest.timestamp - self.clock.offset, 0.0)

    @property
    def time_since_check(self) -> float:
        """Return the time [s] since the RTDE client last checked for packets.
        It is large if the process hangs.
        """
        return time.monotonic() - self._looked

    def send(self, recipe: int, values: Sequence[Any]) -> None:
        """Send the values of an RTDE input recipe from the client to the UR robot.

        Args:
            recipe: index of the recipe, from 0, in the order of `inputs`.
        Raises:
            OSError: the connection is lost.
        """
        data = bytes([recipe + 1]) + self._recipes[recipe].pack(values)
        with self._sending:
            self._socket.sendall(rtde.frame(rtde.DATA, data))

    def close(self) -> None:
        self._open = False
        if hasattr(self, "_socket"):
            with contextlib.suppress(OSError):  # the other side may have closed it first
                self._socket.shutdown(socket.SHUT_RDWR)
            self._socket.close()
        if hasattr(self, "_thread") and self._thread is not threading.current_thread():
            self._thread.join(timeout=2.0)
