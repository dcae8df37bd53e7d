"""Command port (TCP 1337) and state stream (UDP) of the emulated Franka arm."""

from __future__ import annotations

import struct
from collections.abc import Callable

from armcell.drivers.franka.wire import commands as wire
from armcell.drivers.franka.wire.commands import Command, ConnectStatus, SetterStatus
from armcell.drivers.franka.wire.state import COMMAND, RobotCommand, read_command
from armcell.emulators.franka.generators import Reflex
from armcell.emulators.franka.robot import Robot
from armcell.emulators.franka.robot_state import StateWriter
from armcell.emulators.network import Link, Network


class CommandServer:
    """Emulated Franka command server for one client at a time, like the robot; closes other connections.

    Attributes:
        active: whether the Franka Control Interface is active (in Desk); otherwise connections are closed.
    """

    def __init__(self, robot: Robot, network: Network, host: str, urdf: str, port: int = wire.PORT):
        self._robot, self._urdf = robot, urdf
        self._client: Link | None = None
        self._state_to: tuple[str, int] | None = None
        self.udp = network.datagrams(host, "FCI states")
        self._writer = StateWriter(robot)
        self.active = True
        network.listen(host, port, self._begin, self._data, "FCI commands")

    @property
    def connected(self) -> bool:
        return self._client is not None and self._client.open

    def set_active(self, active: bool) -> None:
        """Activate or deactivate the emulated Franka command interface (FCI), as an operator does in Desk."""
        self.active = active
        if not active and self._client is not None:
            self._client.close()

    def _begin(self, link: Link) -> None:
        if self._client is not None and self._client.open:
            self._client.read()  # notices a client that has just disconnected
        if not self.active or self.connected:
            link.close()
            return
        self._client, self._state_to = link, None

    def commands(self) -> list[RobotCommand]:
        """Return the emulated Franka arm's valid UDP motion commands since the last call."""
        found = []
        for data in self.udp.receive(COMMAND.size + 1):
            try:
                found.append(read_command(data))
            except ValueError:
                self._robot.announce(f"a command of {len(data)} bytes was dropped")
        if not self.connected and self._robot.motion is not None:
            self._robot.abort(Reflex("communication_constraints_violation", "the client disconnected"))
        return found

    def send_state(self) -> None:
        if self.connected and self._state_to is not None:
            self.udp.send(self._writer.write(), self._state_to)

    def _data(self, link: Link) -> None:
        while link.open:
            try:
                request = wire.take_message(link.received)
            except ValueError as error:
                self._robot.announce(f"connection closed: {error}")
                link.close()
                return
            if request is None:
                return
            self._answer(link, *request)

    def _answer(self, link: Link, command: int, identifier: int, payload: bytes) -> None:
        def answer(status: int, more: bytes = b"") -> None:
            link.send(wire.message(command, identifier, wire.STATUS.pack(status) + more))

        layout = wire.REQUESTS.get(command)  # type: ignore[call-overload]
        if layout is None or len(payload) != layout.size:
            self._robot.announce(f"connection closed: command {command} with {len(payload)} bytes")
            link.close()
            return
        values = layout.unpack(payload)
        if self._state_to is None and command != Command.CONNECT:
            link.close()
        elif command == Command.CONNECT:
            self._connect(link, answer, *values)
        elif command == Command.MOVE:
            self._move(payload, answer)
        elif command == Command.STOP_MOVE:
            answer(self._robot.stop())
        elif command == Command.AUTOMATIC_ERROR_RECOVERY:
            self._robot.recover(answer)
        elif command == Command.GET_ROBOT_MODEL:
            answer(0, self._urdf.encode())
        else:
            answer(self._set(Command(command), values))

    def _connect(self, link: Link, answer: Callable[[int, bytes], None], version: int, port: int) -> None:
        compatible = version == wire.VERSION
        status = ConnectStatus.SUCCESS if compatible else ConnectStatus.INCOMPATIBLE_VERSION
        answer(status, struct.pack("<H", wire.VERSION))
        if compatible:
            self._state_to = (link.socket.getpeername()[0], port)

    def _move(self, payload: bytes, answer: Callable[[int], None]) -> None:
        try:
            request = wire.MoveRequest.unpack(payload)
        except ValueError:
            answer(wire.MoveStatus.INVALID_ARGUMENT)
            return
        self._robot.move(request, answer)

    def _set(self, command: Command, values: tuple) -> SetterStatus:
        robot = self._robot
        if robot.may_set is not SetterStatus.SUCCESS:
            return robot.may_set
        match command:
            case Command.SET_COLLISION_BEHAVIOR:
                return robot.set_thresholds(values)
            case Command.SET_JOINT_IMPEDANCE:
                return robot.set_stiffness(True, values)
            case Command.SET_CARTESIAN_IMPEDANCE:
                return robot.set_stiffness(False, values)
            case Command.SET_EE_TO_K:
                return robot.set_frame("EE_T_K", values)
            case Command.SET_NE_TO_EE:
                return robot.set_frame("NE_T_EE", values)
            case Command.SET_LOAD:
                return robot.set_load(values[0], values[1:4], values[4:])
        robot.guiding_axes = values
        return SetterStatus.SUCCESS
