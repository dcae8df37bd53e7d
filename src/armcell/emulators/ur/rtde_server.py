"""RTDE port (30004) of the emulated UR controller."""

from __future__ import annotations

import logging
import struct

import numpy as np

from armcell.drivers.ur.wire import rtde
from armcell.emulators.network import Network, TcpConnection
from armcell.emulators.ur.robot import Robot
from armcell.emulators.ur.rtde_outputs import Getter, outputs_of

log = logging.getLogger(__name__)

MAX_INPUT_RECIPES = 255
NEVER = 2**31  # control steps between two packets of a client that asks for nearly no packets


class _Client:
    def __init__(self) -> None:
        self.protocol = 1  # until the client asks for another version
        self.outputs: rtde.Recipe | None = None
        self.getters: list[Getter] = []
        self.every = 1
        self.inputs: dict[int, rtde.Recipe] = {}
        self.started = False
        self.count = 0


class RtdeServer:
    """Server of all RTDE clients of one emulated UR controller."""

    def __init__(self, robot: Robot, network: Network, host: str, port: int = rtde.PORT):
        self._robot, self._table = robot, outputs_of(robot)
        self._clients: dict[TcpConnection, _Client] = {}
        self.port = network.listen(host, port, self._begin, self._data, "RTDE")

    @property
    def clients(self) -> int:
        """Return the number of RTDE clients that are connected to the emulated UR controller."""
        return sum(link.open for link in self._clients)

    def _begin(self, link: TcpConnection) -> None:
        self._clients[link] = _Client()

    def _data(self, link: TcpConnection) -> None:
        client = self._clients.get(link)
        if client is None:
            return
        try:
            for kind, payload in rtde.frames(link.received):
                self._handle(link, client, kind, payload)
        except (rtde.RtdeError, struct.error) as error:
            log.info("RTDE client cut off: %s", error)
            link.close()  # a real controller also closes the link after invalid data

    def _handle(self, link: TcpConnection, client: _Client, kind: int, payload: bytes) -> None:
        r = self._robot
        if kind == rtde.DATA:
            recipe = client.inputs.get(payload[0]) if payload else None
            if recipe is None or len(payload) != 1 + recipe.size or not r.accepts_remote_commands:
                return  # ur_rtde 1.6.5's getForwardKinematics(q, tcp) uses the ID of another recipe
            values = recipe.unpack(payload[1:])
            if all(np.all(np.isfinite(v)) for v in values.values()):
                r.set_inputs(values)
            return
        if kind == rtde.MESSAGE:
            r.popup(f"RTDE client: {rtde.message_text(payload)}")  # RTDE has no answer to a client's message
            return
        if kind == rtde.VERSION:
            (version,) = struct.unpack(">H", payload)
            client.protocol = version if version in (1, 2) else client.protocol
            answer = b"\x01" if version in (1, 2) else b"\x00"
        elif kind == rtde.CONTROLLER_VERSION:
            answer = struct.pack(">4I", *r.model.version)
        elif kind == rtde.SETUP_OUTPUTS:
            answer = self._setup_outputs(client, payload)
        elif kind == rtde.SETUP_INPUTS:
            answer = self._setup_inputs(client, payload)
        elif kind == rtde.START:
            client.started = client.outputs is not None
            answer = bytes([client.started or bool(client.inputs)])
        elif kind == rtde.PAUSE:
            client.started, answer = False, b"\x01"
        else:
            raise rtde.RtdeError(f"type {kind}")
        link.send(rtde.frame(kind, answer))

    def _setup_outputs(self, client: _Client, payload: bytes) -> bytes:
        """Set up the recipe of output variables that an RTDE client requests from the emulated UR controller.

        Protocol version 1 has neither a frequency nor a recipe ID.
        """
        highest = self._robot.model.frequency
        if client.protocol == 1:
            frequency, names, number = highest, rtde.split_names(payload), b""
        else:
            frequency, names = struct.unpack_from(">d", payload)[0], rtde.split_names(payload[8:])
            number = b"\x01"
        known = [rtde.OUTPUTS.get(n, "NOT_FOUND") for n in names]
        if "NOT_FOUND" not in known and np.isfinite(frequency) and frequency > 0:
            client.outputs = rtde.Recipe(names, known)
            client.every = int(min(max(highest / frequency, 1), NEVER))
            client.getters = [self._table[n] for n in names]
        return number + ",".join(known).encode()

    def _setup_inputs(self, client: _Client, payload: bytes) -> bytes:
        names = rtde.split_names(payload)
        kinds = [rtde.INPUTS.get(n, "NOT_FOUND") for n in names]
        others = [c for other, c in self._clients.items() if c is not client and other.open]
        used = {n for c in others for recipe in c.inputs.values() for n in recipe.names}
        kinds = ["IN_USE" if n in used else k for n, k in zip(names, kinds)]
        good = not {"NOT_FOUND", "IN_USE"} & set(kinds) and len(client.inputs) < MAX_INPUT_RECIPES
        number = len(client.inputs) + 1 if good else 0
        if good:
            client.inputs[number] = rtde.Recipe(names, kinds)
        return bytes([number]) + ",".join(kinds).encode()

    def send_outputs(self) -> None:
        """Send RTDE output variables of the emulated UR controller to all clients that are due.
        Call this once per control step.
        """
        for link, client in list(self._clients.items()):
            if not link.open:
                del self._clients[link]
            elif client.started and client.outputs is not None:
                client.count += 1
                if client.count >= client.every:
                    client.count = 0
                    data = client.outputs.pack(get() for get in client.getters)
                    number = b"" if client.protocol == 1 else b"\x01"
                    link.send(rtde.frame(rtde.DATA, number + data))
