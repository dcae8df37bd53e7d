"""Emulated Franka Hand and its port (TCP 1338, state by UDP)."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass

from armcell.drivers.franka.wire import gripper as wire
from armcell.drivers.franka.wire.gripper import Command, Status
from armcell.emulators.franka.plant import PERIOD, FrankaPlant
from armcell.emulators.network import Network, TcpConnection

MAX_SPEED = 0.1  # [m/s] of the width
STATE_PERIOD = 10  # [ms]
STALLED = 2e-3  # [m/s] width speed below which a moving hand has stopped
STALL_TIME = 0.15  # [s]
ARRIVED = 1e-3  # [m]
TEMPERATURE = 30  # [C]


@dataclass
class _Task:
    """Command that the emulated Franka Hand executes: the goal, the limits,
    and the function that receives the result.
    """

    command: Command
    answer: Callable[[Status], None]
    goal: float
    speed: float  # [m/s]
    force: float  # [N]
    low: float = 0.0  # [m] smallest and largest width of a successful grasp
    high: float = 0.0
    still: float = 0.0  # [s] without motion


class Hand:
    """Physics and commands of the emulated Franka Hand.

    Attributes:
        present: whether a hand is mounted.
        homed: whether homing has measured the largest width; without it, the hand rejects motions.
    """

    def __init__(self, plant: FrankaPlant):
        self._plant = plant
        self.present, self.homed = plant.hand is not None, True
        self.is_grasped = False
        self._task: _Task | None = None
        self._ramp, self._width = 0.0, self.width
        self._grasp: tuple[float, float] | None = None  # width range of the object in the hand

    @property
    def width(self) -> float:
        if self._plant.hand is None:
            return 0.0
        return self._plant.world.gripper_width(self._plant.hand.name)

    @property
    def max_width(self) -> float:
        hand = self._plant.hand
        return hand.max_width if hand is not None and self.homed else 0.0

    def start(self, command: Command, values: tuple, answer: Callable[[Status], None]) -> None:
        """Start a command of the emulated Franka Hand. `answer` is called when the command ends."""
        self._end(Status.ABORTED)
        hand = self._plant.hand
        if hand is None or (command is not Command.HOMING and not self.homed):
            answer(Status.FAIL)
        elif command is Command.HOMING:
            self._begin(_Task(command, answer, hand.max_width, MAX_SPEED, hand.max_force))
        elif command is Command.MOVE:
            width, speed = values
            valid = 0.0 <= width <= self.max_width + 1e-6 and speed > 0.0
            if not valid:
                answer(Status.FAIL)
                return
            self._begin(_Task(command, answer, width, min(speed, MAX_SPEED), hand.max_force))
        else:
            width, inner, outer, speed, force = values
            if not (0.0 <= width <= self.max_width + 1e-6 and speed > 0.0 and 0.0 < force <= hand.max_force):
                answer(Status.FAIL)
                return
            low, high = width - inner, width + outer
            self._begin(_Task(command, answer, 0.0, min(speed, MAX_SPEED), force, low, high))

    def _begin(self, task: _Task) -> None:
        self._task, self._ramp = task, self.width
        self._width = self._ramp
        self.is_grasped, self._grasp = False, None

    def stop(self) -> None:
        """End the command that the emulated Franka Hand executes, and release the grasp force."""
        self._end(Status.ABORTED)
        if self._plant.hand is not None:
            self._drive(self.width, 1.0)
        self.is_grasped, self._grasp = False, None

    def _end(self, status: Status) -> None:
        task, self._task = self._task, None
        if task is not None:
            task.answer(status)

    def _drive(self, width: float, force: float) -> None:
        if self._plant.hand is not None:
            self._plant.world.set_gripper_target(self._plant.hand.name, max(width, 0.0), force)

    def step(self) -> None:
        """Advance the command that the emulated Franka Hand executes by one millisecond."""
        width = self.width
        speed, self._width = (width - self._width) / PERIOD, width
        if self._grasp is not None:
            self.is_grasped = self._grasp[0] <= width <= self._grasp[1]
        task = self._task
        if task is None:
            return
        lead = task.speed * PERIOD
        self._ramp += min(max(task.goal - self._ramp, -lead), lead)
        self._drive(self._ramp, task.force)
        at_goal = abs(width - task.goal) < ARRIVED and self._ramp == task.goal
        task.still = task.still + PERIOD if abs(speed) < STALLED else 0.0
        if at_goal or task.still > STALL_TIME:
            self._arrived(task, width, at_goal)

    def _arrived(self, task: _Task, width: float, at_goal: bool) -> None:
        if task.command is Command.GRASP:
            self.is_grasped = task.low < width < task.high
            self._grasp = (task.low, task.high) if self.is_grasped else None
            self._drive(task.goal, task.force)  # keep pressing; the hand closes if the object slips away
            self._end(Status.SUCCESS if self.is_grasped else Status.UNSUCCESSFUL)
        else:
            self.homed = self.homed or task.command is Command.HOMING
            self._end(Status.SUCCESS if at_goal else Status.UNSUCCESSFUL)

    def follow_reset(self) -> None:
        self._end(Status.ABORTED)
        self.is_grasped, self._grasp = False, None


class HandServer:
    """Server of the emulated Franka Hand. Each client receives its own stream of states."""

    def __init__(self, hand: Hand, network: Network, host: str, port: int = wire.PORT):
        self._hand, self._udp = hand, network.datagrams(host, "hand state")
        self._clients: dict[TcpConnection, tuple[str, int]] = {}
        self._time = 0
        network.listen(host, port, self._begin, self._data, "hand")

    def _begin(self, link: TcpConnection) -> None:
        if not self._hand.present:
            link.close()

    def step(self) -> None:
        """Advance the emulated Franka Hand by one millisecond and send its state."""
        self._time += 1
        self._hand.step()
        if self._time % STATE_PERIOD:
            return
        hand = self._hand
        state = wire.STATE.pack(
            self._time & 0xFFFFFFFF, hand.width, hand.max_width, hand.is_grasped, TEMPERATURE
        )
        for link, to in list(self._clients.items()):
            if link.open:
                self._udp.send(state, to)
            else:
                del self._clients[link]

    def _data(self, link: TcpConnection) -> None:
        while link.open:
            try:
                request = wire.take_message(link.received)
            except ValueError:
                link.close()
                return
            if request is None:
                return
            self._answer(link, *request)

    def _answer(self, link: TcpConnection, command: int, identifier: int, payload: bytes) -> None:
        def answer(status: int, more: bytes = b"") -> None:
            link.send(wire.message(command, identifier, wire.STATUS.pack(status) + more))

        layout = wire.REQUESTS.get(command)  # type: ignore[call-overload]
        if layout is None or len(payload) != layout.size:
            link.close()
            return
        values = layout.unpack(payload)
        if command == Command.CONNECT:
            version, port = values
            answer(0 if version == wire.VERSION else 1, struct.pack("<H", wire.VERSION))
            if version == wire.VERSION:
                self._clients[link] = (link.socket.getpeername()[0], port)
        elif command == Command.STOP:
            self._hand.stop()
            answer(Status.SUCCESS)
        else:
            self._hand.start(Command(command), values, answer)
