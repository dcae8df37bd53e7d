"""Worker subprocess that moves one Franka arm at 1 kHz, free of armcell's interpreter lock.

`python worker_main.py FD HOST WATCHDOG BACKEND LIMITS` starts it: FD is a stream socket with messages of
`worker_messages`, LIMITS are the joint limits [rad] as JSON, [lower, upper].
Orders: beat, setup, recover, trajectory (its rows precede it), point, cancel, end.
"""

from __future__ import annotations

import json
import os
import resource
import select
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from enum import IntEnum
from typing import Any

import numpy as np

from armcell.drivers.franka import worker_messages
from armcell.drivers.franka.client import FciClient, FciError
from armcell.drivers.franka.setpoint_stream import SampledTrajectory, SetpointStream, TimedSetpoints
from armcell.drivers.franka.wire.commands import (
    STATUS,
    Command,
    MoveController,
    MoveGenerator,
    MoveRequest,
    MoveStatus,
    WireError,
)
from armcell.drivers.franka.wire.state import GeneratorMode, RobotCommand, RobotMode, RobotState, read_state

LIBRARY_MEMORY = 2 << 30  # bytes that a worker with a library may address
OWN = "own"  # backend; the other one is "franky"
REPORT = 4  # [ms] between the states that armcell receives
START_DISTANCE = 0.05  # [rad] largest distance of a motion's start from the arm
START_TIME = 2.0  # [s] in which the robot must be ready for the next motion
REST_TIME = 1.0  # [s] in which the robot ends a motion before the connection closes
ACCEPTED = (MoveStatus.SUCCESS, MoveStatus.STARTED)
REJECTED = {
    MoveStatus.NOT_POSSIBLE: "the robot rejects a motion in its current mode",
    MoveStatus.INVALID_ARGUMENT: "the robot rejects the motion's parameters",
    MoveStatus.EMERGENCY_ABORTED: "user stop",
}


class Worker:
    """Worker of one Franka arm, which receives orders,
    commands the robot in every cycle and reports the states.
    """

    def __init__(
        self, link: socket.socket, client: FciClient, watchdog: float, limits: list[list[float]]
    ):  # fmt: skip
        self._link, self._client, self._watchdog, self._limits = link, client, watchdog, limits
        self._received, self._rows = bytearray(), b""
        self._answers: dict[int, Callable[[bytes], None]] = {}
        self._beaten, self._pace = time.monotonic(), 1.0
        self._open = True
        self._state: RobotState | None = None
        self._setpoints: SetpointStream | None = None
        self._waiting: tuple[float, SampledTrajectory | TimedSetpoints] | None = (
            None  # source of a motion that has not started
        )
        self._points: TimedSetpoints | None = None
        self._number, self._streaming = 0, False
        self._moving, self._ending = False, False
        client.tcp.setblocking(False)
        link.setblocking(True)

    def run(self) -> None:
        """Run the worker of a Franka arm: execute the orders of armcell until armcell closes the connection.
        Then stop the arm.
        """
        sockets = [self._client.udp, self._client.tcp, self._link]
        try:
            while self._open:
                ready, _, _ = select.select(sockets, [], [], 0.02)
                if self._client.udp in ready:
                    self._read_states()
                if self._client.tcp in ready:
                    self._take_answers()
                if self._link in ready:
                    self._read_orders()
                self._check_watchdog()
        except FciError as error:
            self._event(lost=str(error))
        finally:
            with suppress(OSError, FciError):
                self._rest()
            self._client.close()

    def _rest(self) -> None:
        """Stop a moving Franka arm, and wait until the robot has ended the motion.

        A client that disconnects earlier causes a reflex.
        """
        self._cancel()
        end = time.monotonic() + REST_TIME
        while self._moving and time.monotonic() < end:
            if select.select([self._client.tcp], [], [], 0.02)[0]:
                self._take_answers()

    def _take_answers(self) -> None:
        for identifier, content in self._client.answers():
            self._answers.pop(identifier, lambda _: None)(content)

    # --- armcell ---
    def _event(self, **event: Any) -> None:
        self._write(worker_messages.pack_json(worker_messages.EVENT, event))

    def _write(self, data: bytes) -> None:
        try:
            self._link.sendall(data)
        except OSError:
            self._open = False

    def _read_orders(self) -> None:
        self._open = worker_messages.read_into(self._link, self._received)
        while (message := worker_messages.take_message(self._received)) is not None:
            kind, content = message
            if kind == worker_messages.ROWS:
                self._rows = content
            else:
                self._obey(json.loads(content))

    def _obey(self, order: dict[str, Any]) -> None:
        match order["do"]:
            case "beat":
                self._beaten = time.monotonic()
            case "pace":
                self._pace = order["pace"]
            case "trajectory":
                rows = np.frombuffer(self._rows, dtype="<f8").reshape(-1, 7)
                self._begin(SampledTrajectory(rows), order["number"], streaming=False)
            case "point":
                self._take_point(order)
            case "cancel":
                self._cancel()
            case "ask":
                self._ask(order)
            case "end":
                self._open = False

    def _ask(self, order: dict[str, Any]) -> None:
        """Send a command from the worker to the Franka robot, and report the status in the answer."""

        def report(content: bytes) -> None:
            self._event(answer=order["id"], status=int(self._status(command, content)))

        command = Command(order["command"])
        self._send(command, bytes.fromhex(order["payload"]), report)

    def _status(self, command: Command, content: bytes) -> IntEnum:
        """Decode the status in the robot's answer to a command from the Franka worker. An unknown status ends
        the connection.
        """
        try:
            return self._client.protocol.status(command, STATUS.unpack_from(content)[0])
        except WireError as error:
            raise FciError("protocol", str(error)) from None

    def _send(self, command: Command, payload: bytes, then: Callable[[bytes], None]) -> None:
        try:
            self._answers[self._client.send(command, payload)] = then
        except OSError as error:
            raise FciError("closed", f"the connection broke: {error.strerror}") from None

    # --- motions ---
    def _begin(self, source: SampledTrajectory | TimedSetpoints, number: int, streaming: bool) -> None:
        if self._moving:
            self._cancel()
        self._number, self._streaming = number, streaming
        self._waiting = time.monotonic(), source
        self._beaten = time.monotonic()

    def _take_point(self, order: dict[str, Any]) -> None:
        point = order["at"], np.array(order["q"]), np.array(order["v"])
        if self._points is None or self._points.is_finished or not self._streaming:
            self._points = TimedSetpoints()
            self._points.add(*point)
            self._begin(self._points, 0, streaming=True)
        else:
            self._points.add(*point)

    def _start(self, state: RobotState, since: float, source: SampledTrajectory | TimedSetpoints) -> None:
        """Start the waiting motion of the Franka worker if the robot is idle. The motion has been waiting
        since the time `since` [s, monotonic].
        """
        if state.mode != RobotMode.IDLE or state.generator != GeneratorMode.IDLE:
            if time.monotonic() - since > START_TIME:
                self._drop()
                self._result(f"the robot is not ready: mode {RobotMode(state.mode).name}")
            return
        setpoints = SetpointStream(source, self._pace, self._limits)
        off = setpoints.start_error(state["q_d"])
        if off > START_DISTANCE:
            self._drop()
            self._result(f"the motion starts {off:.3f} rad from the arm")
            return
        self._waiting = None
        self._setpoints, self._moving, self._ending = setpoints, True, False
        request = MoveRequest(MoveController.JOINT_IMPEDANCE, MoveGenerator.JOINT_POSITION)
        number = self._number
        identifier = self._client._identifier + 1

        def answered(content: bytes) -> None:
            status = MoveStatus(self._status(Command.MOVE, content))
            if status is MoveStatus.STARTED:
                self._answers[identifier] = answered  # a second answer follows at the motion's end
            else:
                self._ended(status, number)

        self._send(Command.MOVE, request.pack(self._client.protocol), answered)

    def _drop(self) -> None:
        """Discard the motion that waits in the Franka worker. The next streamed point starts a new one."""
        if self._waiting is not None and self._waiting[1] is self._points:
            self._points = None
        self._waiting = None

    def _ended(self, status: MoveStatus, number: int) -> None:
        self._moving, self._setpoints = False, None
        if self._streaming and self._waiting is None:
            self._points = None
        if status is MoveStatus.SUCCESS:
            self._result("done", number)
        elif status is MoveStatus.PREEMPTED:
            self._result("cancelled", number)
        else:
            errors = ", ".join(self._state.last_errors) if self._state is not None else ""
            self._result(REJECTED.get(status, f"the robot stopped the motion: {errors}"), number)

    def _result(self, text: str, number: int | None = None) -> None:
        self._event(number=self._number if number is None else number, result=text)

    def _cancel(self) -> None:
        if self._waiting is not None:
            self._drop()
            self._result("cancelled")
        if self._moving and not self._ending:
            self._ending, self._setpoints = True, None
            self._send(Command.STOP_MOVE, b"", lambda _: None)

    def _check_watchdog(self) -> None:
        if (self._moving or self._waiting) and time.monotonic() - self._beaten > self._watchdog:
            self._cancel()

    # --- the robot ---
    def _read_states(self) -> None:
        messages = self._client.states()
        if not messages:
            return
        now, before = time.monotonic(), self._state
        try:
            state = max((read_state(m) for m in messages), key=lambda s: s.time)
        except WireError as error:
            self._event(note=str(error))
            return
        if before is not None and state.time <= before.time:
            return
        ticks = 1 if before is None else state.time - before.time
        self._state = state
        if self._setpoints is not None:
            self._stream(state, ticks, now)
        elif self._waiting is not None:
            self._start(state, *self._waiting)
        report = before is None or state.time // REPORT != before.time // REPORT or state.mode != before.mode
        if report:
            raw = max(messages, key=lambda m: m[:8][::-1])
            clock = self._setpoints.source.clock if self._setpoints is not None else 0.0
            self._write(
                worker_messages.pack(
                    worker_messages.STATE, worker_messages.PROGRESS.pack(now, self._number, clock) + raw
                )
            )

    def _stream(self, state: RobotState, ticks: int, now: float) -> None:
        setpoints = self._setpoints
        if setpoints is None or state.generator != GeneratorMode.JOINT_POSITION:
            return
        q = setpoints.next(ticks, self._pace, now, state["q_d"], state["dq_d"], state["ddq_d"])
        command = RobotCommand(state.time, q=tuple(q.tolist()), motion_finished=setpoints.finished)
        self._client.command(command.pack(self._client.protocol.version))


def _client(host: str, backend: str) -> FciClient:
    if backend == OWN:
        return FciClient(host)
    # libfranka allocates what the length of a damaged message demands, up to 4 GB.
    resource.setrlimit(resource.RLIMIT_AS, (LIBRARY_MEMORY, LIBRARY_MEMORY))
    from armcell.drivers.franka.franky_client import FrankyClient  # imports the library

    return FrankyClient(host)


def main(descriptor: str, host: str, watchdog: str, backend: str, limits: str) -> None:
    link = socket.socket(fileno=int(descriptor))
    with suppress(PermissionError, AttributeError):  # the robot stops after 20 late answers
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(11))
    try:
        client = _client(host, backend)
    except FciError as error:
        link.sendall(worker_messages.pack_json(worker_messages.EVENT, {"failed": str(error)}))
        return
    link.sendall(worker_messages.pack_json(worker_messages.EVENT, {"ready": True}))
    Worker(link, client, float(watchdog), json.loads(limits)).run()
