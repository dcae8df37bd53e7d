"""Grippers on a UR arm's tool: Robotiq's socket protocol, or open/close by digital output."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from typing import Protocol

from armcell.core import ArmcellError, InputError
from armcell.model import Gripper

TOOL_INPUTS = 16  # bit number of the tool's first digital input
POLL = 0.05  # [s] between position requests
RECONNECT = 0.5  # [s] timeout of an attempt to reconnect
LOOK = "look at its URCap and cable"


class SocketGripper:
    """Gripper on a UR arm that uses Robotiq's socket protocol. A thread polls its state."""

    hint = LOOK

    def __init__(self, host: str, port: int, gripper: Gripper):
        self._gripper, self._lock = gripper, threading.Lock()
        self._address = (host, port)
        try:
            self._connect(3.0)
            self._ask("SET ACT 1 GTO 1")
            self._reading = self._read_now()
        except (OSError, ArmcellError, ValueError) as error:
            raise InputError(
                f"no gripper at {host}:{port}: {error}",
                hint="install the gripper's URCap, or choose 'gripper: {kind: tool_io}', or leave it out",
            ) from None
        self._open, self._told = True, time.monotonic()
        self._thread = threading.Thread(target=self._watch, name=f"gripper {host}", daemon=True)
        self._thread.start()

    def _connect(self, timeout: float) -> None:
        self._socket = socket.create_connection(self._address, timeout)
        self._file = self._socket.makefile("rwb")

    def _ask(self, text: str) -> str:
        with self._lock:
            self._file.write(text.encode() + b"\n")
            self._file.flush()
            answer = self._file.readline(256).decode("ascii", "replace").strip()
        if not answer:
            raise ArmcellError("it closed the connection")
        return answer

    def _read_now(self) -> tuple[float, bool]:
        position = int(self._ask("GET POS").split()[1])
        holds = self._ask("GET OBJ").split()[1] in ("1", "2")
        return (1.0 - position / 255) * self._gripper.max_width, holds

    def _watch(self) -> None:
        """Poll the state of a UR arm's socket gripper.
        If the connection is lost, reconnect without moving the gripper.
        """
        while self._open:
            try:
                self._reading = self._read_now()
                self._told = time.monotonic()
            except (OSError, ArmcellError, ValueError, IndexError):
                with self._lock, contextlib.suppress(OSError):
                    self._socket.close()
                    self._connect(RECONNECT)
            time.sleep(POLL)

    @property
    def time_since_answer(self) -> float:
        return time.monotonic() - self._told

    def drive(self, width: float, force: float) -> None:
        position = round(255 * (1.0 - width / self._gripper.max_width))
        strength = round(255 * force / self._gripper.max_force)
        position, strength = (min(max(n, 0), 255) for n in (position, strength))
        try:
            self._ask(f"SET POS {position} FOR {strength} GTO 1")
        except (OSError, ArmcellError) as error:
            raise ArmcellError(f"the gripper does not answer: {error}") from None

    def read(self) -> tuple[float, bool]:
        return self._reading

    def close(self) -> None:
        self._open = False
        self._thread.join(timeout=1.0)
        self._socket.close()


class ToolPins(Protocol):
    """Interface through which a `ToolGripper` uses the digital inputs and outputs of its UR arm."""

    def set_tool_output(self, pin: int, on: bool) -> None: ...

    def digital_input(self, bit: int) -> bool: ...


class ToolGripper:
    """Gripper at the tool connector of a UR arm that only opens and closes.
    Tool output 0 closes it, and tool input 0 reports a grasp.
    """

    hint = LOOK

    def __init__(self, arm: ToolPins, gripper: Gripper):
        self._arm, self._gripper, self._closed = arm, gripper, False

    def drive(self, width: float, force: float) -> None:
        self._closed = width < 0.5 * self._gripper.max_width
        self._arm.set_tool_output(0, self._closed)

    @property
    def time_since_answer(self) -> float:
        return 0.0  # its input is part of the arm's state, which the supervisor checks

    def read(self) -> tuple[float, bool]:
        holds = self._arm.digital_input(TOOL_INPUTS)
        return (0.0 if self._closed else self._gripper.max_width), holds

    def close(self) -> None:
        pass
