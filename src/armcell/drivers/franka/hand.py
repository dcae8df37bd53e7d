"""The Franka Hand over its own port: homing, finger motions and grasps."""

from __future__ import annotations

import contextlib
import socket
import threading
import time

from armcell.core import ArmcellError, InputError
from armcell.drivers.franka.settings import HandSettings
from armcell.drivers.franka.wire import gripper as wire
from armcell.drivers.franka.wire.commands import WireError
from armcell.drivers.franka.wire.gripper import Command, Status
from armcell.model import Gripper

TIMEOUT = 2.0  # [s] for a connection
HOMING_TIME = 20.0  # [s]
NARROWEST = 0.001  # [m] width below which a closed hand holds nothing
SAME = 1e-4  # [m] targets that are equal
MIN_FORCE = 1.0  # [N]


class FrankaHand:
    """Connection to a Franka Hand. A thread reads the state of the hand and the results of its commands.

    Raises:
        InputError: no hand answers, or it is not homed.
    """

    hint = "look at the hand's cable and at Desk"

    def __init__(self, host: str, settings: HandSettings, gripper: Gripper):
        self._gripper, self._settings, self._host = gripper, settings, host
        self._identifier, self._lock = 0, threading.Lock()
        self._results: dict[int, int] = {}
        self._target: tuple[float, float] | None = None
        self._pending = 0  # identifier of the running command
        self._reading, self._max_width = (0.0, False), 0.0
        self._heard = time.monotonic()
        try:
            self._connect()
        except (OSError, ArmcellError, WireError) as error:
            raise InputError(
                f"no Franka Hand answers at {host}:{wire.PORT}: {error}",
                hint="mount the hand and select it in Desk, or remove 'gripper' from the cell file",
            ) from None
        self._open = True
        self._threads = [
            threading.Thread(target=run, name=f"hand {host}", daemon=True)
            for run in (self._read_states, self._read_answers)
        ]
        for thread in self._threads:
            thread.start()
        try:
            self._check_homed()
        except BaseException:
            self.close()
            raise

    def _connect(self) -> None:
        self._tcp = socket.create_connection((self._host, wire.PORT), TIMEOUT)
        self._udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._udp.bind((self._tcp.getsockname()[0], 0))
            self._udp.settimeout(TIMEOUT)
            self._received = bytearray()
            request = wire.REQUESTS[Command.CONNECT].pack(wire.VERSION, self._udp.getsockname()[1])
            self._tcp.sendall(wire.message(Command.CONNECT, 0, request))
            answer = None
            while answer is None:
                self._receive()
                answer = wire.take_message(self._received)
            status, version = wire.CONNECTED.unpack(answer[2])
            if status != 0:
                raise ArmcellError(f"it speaks version {version} of its protocol, armcell {wire.VERSION}")
            self._take_state(self._udp.recv(wire.STATE.size + 1))
        except BaseException:
            self._tcp.close()
            self._udp.close()
            raise

    def _receive(self) -> None:
        data = self._tcp.recv(4096)
        if not data:
            raise ArmcellError("it closed the connection")
        self._received += data

    def _check_homed(self) -> None:
        if self._settings.homing:
            self.home()
        if self._max_width <= 0.0:
            raise InputError(
                f"the hand at {self._host} is not homed, so it rejects motions",
                hint="home it in Desk, or set 'gripper: {kind: hand, homing: true}': the fingers move then",
            )

    # --- threads ---
    def _take_state(self, data: bytes) -> None:
        if len(data) == wire.STATE.size:
            _, width, self._max_width, grasped, _ = wire.STATE.unpack(data)
            self._reading = (width, bool(grasped))
            self._heard = time.monotonic()

    def _read_states(self) -> None:
        while self._open:
            with contextlib.suppress(OSError):
                self._take_state(self._udp.recv(wire.STATE.size + 1))

    def _read_answers(self) -> None:
        while self._open:
            try:
                while (message := wire.take_message(self._received)) is not None:
                    self._results[message[1]] = wire.STATUS.unpack_from(message[2])[0]
                self._receive()
            except TimeoutError:
                continue
            except (OSError, ArmcellError, WireError):
                if not self._open:
                    return
                time.sleep(0.1)
                self._reconnect()

    def _reconnect(self) -> None:
        """Reconnect to the Franka Hand after the connection was lost. The hand does not move."""
        with self._lock:
            self._udp.close()
            self._tcp.close()
            self._target = None
            with contextlib.suppress(OSError, ArmcellError, WireError):
                self._connect()

    # --- commands ---
    def _send(self, command: Command, *values: float) -> int:
        with self._lock:
            self._identifier += 1
            payload = wire.REQUESTS[command].pack(*values)
            self._tcp.sendall(wire.message(command, self._identifier, payload))
            return self._identifier

    def home(self) -> None:
        """Home the Franka Hand, which moves its fingers to measure the largest width.

        Raises:
            InputError: homing failed.
        """
        identifier = self._send(Command.HOMING)
        end = time.monotonic() + HOMING_TIME
        while identifier not in self._results and time.monotonic() < end:
            time.sleep(0.01)
        if self._results.pop(identifier, Status.FAIL) != Status.SUCCESS:
            raise InputError(f"the hand at {self._host} cannot be homed", hint="free its fingers; see Desk")
        time.sleep(0.05)  # the next state has the measured width

    def drive(self, width: float, force: float) -> None:
        force = min(max(force, MIN_FORCE), self._gripper.max_force)
        target = (float(width), float(force))
        if (
            self._target is not None
            and abs(target[0] - self._target[0]) < SAME
            and target[1] == self._target[1]
        ):
            return
        self._target = target
        try:
            if width < NARROWEST:  # grasp whatever is between the fingers
                middle = 0.5 * self._max_width
                self._send(Command.GRASP, middle, middle - NARROWEST, middle, self._settings.speed, force)
            else:
                self._send(Command.MOVE, min(width, self._max_width), self._settings.speed)
        except OSError as error:
            raise ArmcellError(f"the hand does not answer: {error}") from None

    def read(self) -> tuple[float, bool]:
        return self._reading

    @property
    def time_since_answer(self) -> float:
        return time.monotonic() - self._heard

    def close(self) -> None:
        self._open = False
        with contextlib.suppress(OSError):
            self._tcp.shutdown(socket.SHUT_RDWR)
        self._tcp.close()
        self._udp.close()
        for thread in self._threads:
            thread.join(timeout=TIMEOUT + 0.5)
