"""Command port (TCP 1337) and state stream (UDP) of the emulated Franka arm, with its state message."""

from __future__ import annotations

import struct
from collections.abc import Callable
from enum import IntEnum

import numpy as np

from armcell.drivers.franka import settings
from armcell.drivers.franka.wire import commands as wire
from armcell.drivers.franka.wire.commands import Command, ConnectStatus, Protocol, SetterStatus
from armcell.drivers.franka.wire.state import (
    COMMANDS,
    FIELDS,
    INDEX,
    RobotCommand,
    StateMessage,
    read_command,
)
from armcell.emulators.franka.motion_generators import Reflex, elbow_of
from armcell.emulators.franka.robot import Robot
from armcell.emulators.network import Network, TcpConnection

GRAVITY, NO_ELBOW_RATES = np.array([0.0, 0.0, -9.81]), np.zeros(4)  # O_ddP_O; delbow_c and ddelbow_c
MAX_CUTOFF = 1000.0  # [Hz]; disables a filter


class StateWriter:
    """Writer of the state messages that the command server of an emulated Franka robot sends. It reuses one
    message buffer in every cycle.
    """

    def __init__(self, robot: Robot, version: int = 10):
        self._robot, self._message = robot, StateMessage(version)
        m = self._message
        m["F_T_NE"] = robot.T_F_NE.T.ravel()
        if robot.plant.hand is not None:
            m["m_ee"], m["F_x_Cee"] = settings.HAND_MASS, settings.HAND_CENTER
            m["I_ee"] = np.diag(settings.HAND_INERTIA).ravel()
        self._frame, self._load = None, None  # parameters that the message has
        self._moving = m.numbers[FIELDS["elbow"].start : FIELDS["dtheta"].stop]

    def write(self) -> bytes:
        """Write the state of the emulated Franka arm to the message of its command server, and return the
        bytes for the current 1 ms cycle.
        """
        r, m = self._robot, self._message
        reference, motion = r.reference, r.motion
        cartesian = motion is not None and motion.generator.cartesian
        wanted, elbow = r.O_T_EE_d, elbow_of(reference.q)
        m["O_T_EE"], m["O_T_EE_d"] = r.O_T_EE.T.ravel(), wanted.T.ravel()
        if self._frame is not r.F_T_EE or self._load is not r.load:
            self._frame, self._load = r.F_T_EE, r.load
            m["F_T_EE"], m["NE_T_EE"] = r.F_T_EE.T.ravel(), r.NE_T_EE.T.ravel()
            m["EE_T_K"] = r.EE_T_K.T.ravel()
            m["m_load"], m["F_x_Cload"], m["I_load"] = r.load.mass, r.load.center, r.load.inertia
        np.concatenate(
            (
                r.elbow, elbow, r.plant.torques(), r.torque, r.torque_rate, r.q, reference.q, r.dq,
                reference.dq, reference.ddq, r.joint_contact, r.cartesian_contact, r.joint_collision,
                r.cartesian_collision, r.tau_ext, r.O_F_K, r.K_F_K, reference.twist, GRAVITY,
                reference.elbow if cartesian else elbow, NO_ELBOW_RATES,
                (reference.T if cartesian else wanted).T.ravel(), reference.twist, reference.dtwist,
                r.q, r.dq,
            ),
            out=self._moving, casting="same_kind",
        )  # fmt: skip
        for flags, names in ((m.errors, r.errors), (m.reflex_reason, r.last_errors)):
            flags[:] = 0
            for name in names:
                flags[INDEX[name]] = 1
        m.write_scalars(r.time, r.generator_mode, r.controller_mode, r.mode, r.success_rate)
        return bytes(m)


class CommandServer:
    """Server for the commands to an emulated Franka arm.
    Like the robot, it serves one client at a time and closes other connections.

    Attributes:
        active: whether the Franka Control Interface is active (in Desk); otherwise connections are closed.
    """

    def __init__(self, robot: Robot, network: Network, host: str, urdf: str, protocol: Protocol):
        self._robot, self._urdf, self._protocol = robot, urdf, protocol
        self._client: TcpConnection | None = None
        self._state_to: tuple[str, int] | None = None
        self.udp = network.datagrams(host, "FCI states")
        self._writer = StateWriter(robot, protocol.version)
        self.active = True
        network.listen(host, wire.PORT, self._begin, self._data, "FCI commands")

    @property
    def connected(self) -> bool:
        return self._client is not None and self._client.open

    def set_active(self, active: bool) -> None:
        """Switch the command server of the emulated Franka arm on or off (FCI). If it is off, the server has
        no client and refuses connections.
        """
        self.active = active
        if not active and self._client is not None:
            self._client.close()

    def _begin(self, link: TcpConnection) -> None:
        if self._client is not None and self._client.open:
            self._client.read()  # notices a client that has just disconnected
        if not self.active or self.connected:
            link.close()
            return
        self._client, self._state_to = link, None

    def commands(self) -> list[RobotCommand]:
        """Return the valid motion commands that the command server of the emulated Franka arm has received by
        UDP since the last call.
        """
        found, version = [], self._protocol.version
        for data in self.udp.receive(COMMANDS[version].size + 1):
            try:
                found.append(read_command(data, version))
            except ValueError:
                self._robot.announce(f"a command of {len(data)} bytes was dropped")
        if not self.connected and self._robot.motion is not None:
            self._robot.abort(Reflex("communication_constraints_violation", "the client disconnected"))
        return found

    def send_state(self) -> None:
        if self.connected and self._state_to is not None:
            self.udp.send(self._writer.write(), self._state_to)

    def _data(self, link: TcpConnection) -> None:
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

    def _answer(self, link: TcpConnection, code: int, identifier: int, payload: bytes) -> None:
        protocol = self._protocol

        def answer(status: IntEnum, more: bytes = b"") -> None:
            content = wire.STATUS.pack(protocol.status_code(status)) + more
            link.send(wire.message(code, identifier, content))

        command = protocol.command(code)
        if command is None or len(payload) != protocol.requests[command].size:
            self._robot.announce(f"connection closed: command {code} with {len(payload)} bytes")
            link.close()
            return
        values = protocol.requests[command].unpack(payload)
        if self._state_to is None and command is not Command.CONNECT:
            link.close()
            return
        match command:
            case Command.CONNECT:
                self._connect(link, answer, *values)
            case Command.MOVE:
                self._move(payload, answer)
            case Command.STOP_MOVE:
                answer(self._robot.stop())
            case Command.AUTOMATIC_ERROR_RECOVERY:
                self._robot.recover(answer)
            case Command.GET_ROBOT_MODEL:
                answer(SetterStatus.SUCCESS, self._urdf.encode())
            case Command.LOAD_MODEL_LIBRARY:  # a real Panda sends its own, compiled for the client
                self._robot.announce("the client asks for the model library; the emulator has none")
                answer(SetterStatus.NOT_POSSIBLE)
            case Command.GET_CARTESIAN_LIMIT:  # no virtual wall is active
                answer(SetterStatus.SUCCESS, wire.CARTESIAN_LIMIT.pack(*[0.0] * 19, False))
            case _:
                answer(self._set(command, values))

    def _connect(self, link: TcpConnection, answer: Callable[..., None], version: int, port: int) -> None:
        own = self._protocol.version
        status = ConnectStatus.SUCCESS if version == own else ConnectStatus.INCOMPATIBLE_VERSION
        answer(status, struct.pack("<H", own))
        if version == own:
            self._state_to = (link.socket.getpeername()[0], port)

    def _move(self, payload: bytes, answer: Callable[..., None]) -> None:
        try:
            request = wire.MoveRequest.unpack(payload, self._protocol)
        except ValueError:
            answer(wire.MoveStatus.INVALID_ARGUMENT)
            return
        self._robot.move(request, answer)

    def _set(self, command: Command, values: tuple) -> SetterStatus:
        robot = self._robot
        if robot.can_set_parameters is not SetterStatus.SUCCESS:
            return robot.can_set_parameters
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
            case Command.SET_FILTERS:  # the emulator does not filter the client's signals
                good = all(0.0 < f <= MAX_CUTOFF for f in values)
                return SetterStatus.SUCCESS if good else SetterStatus.INVALID_ARGUMENT
        robot.guiding_axes = values
        return SetterStatus.SUCCESS
