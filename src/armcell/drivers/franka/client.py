"""Client of the Franka Control Interface: TCP commands, and UDP states and commands."""

from __future__ import annotations

import contextlib
import select
import socket
import time

from armcell.core import ArmcellError
from armcell.drivers.franka.wire import commands as wire
from armcell.drivers.franka.wire.commands import NEWEST, PROTOCOLS, Command, ConnectStatus, WireError
from armcell.drivers.franka.wire.state import MAX_STATE

TIMEOUT = 2.0  # [s] for an answer


class FciError(ArmcellError):
    """Error of a client of the Franka Control Interface: the robot does not answer,
    or it rejects the connection or a command.

    Attributes:
        kind: "refused", "unreachable", "closed", "version" or "protocol".
    """

    def __init__(self, kind: str, text: str):
        super().__init__(text)
        self.kind = kind


class FciClient:
    """Client of the Franka Control Interface of one robot. A robot serves only one client at a time.

    The connection uses the robot's version of the protocol, if armcell supports it.

    Attributes:
        protocol: the version in use.
    Raises:
        FciError: no robot answers, or it rejects the connection.
    """

    def __init__(self, host: str, port: int = wire.PORT):
        self.host, self.protocol = host, NEWEST
        version = self._open(port)
        if version != NEWEST.version and version in PROTOCOLS:
            self.close()
            self.protocol = PROTOCOLS[version]
            version = self._open(port)
        if version != self.protocol.version:
            self.close()
            known = " and ".join(str(v) for v in PROTOCOLS)
            raise FciError(
                "version", f"{host} speaks version {version} of Franka's protocol, armcell speaks versions "
                f"{known}",
            )  # fmt: skip

    def _open(self, port: int) -> int:
        """Connect the Franka client. Return the requested protocol version if the robot accepts it, or else
        the version that the robot speaks.
        """
        self._identifier, self._received = 0, bytearray()
        self._robot: tuple[str, int] | None = None  # address from which the robot sends its states
        try:
            self.tcp = socket.create_connection((self.host, port), TIMEOUT)
        except ConnectionRefusedError:
            raise FciError("refused", f"{self.host} refuses the connection to port {port}") from None
        except OSError as error:
            text = f"{self.host} does not answer: {error.strerror or error}"
            raise FciError("unreachable", text) from None
        self.tcp.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self.udp.bind((self.tcp.getsockname()[0], 0))
            self.udp.setblocking(False)
            return self._connect()
        except BaseException:
            self.close()
            raise

    def _connect(self) -> int:
        wanted = self.protocol.version
        answer = self.ask(
            Command.CONNECT, wire.REQUESTS[Command.CONNECT].pack(wanted, self.udp.getsockname()[1])
        )
        if len(answer) != wire.CONNECTED.size:
            raise FciError("protocol", f"{self.host} does not answer like a Franka robot")
        status, version = wire.CONNECTED.unpack(answer)
        if status != ConnectStatus.SUCCESS and version == wanted:
            raise FciError("protocol", f"{self.host} rejects its own version {version} of Franka's protocol")
        return wanted if status == ConnectStatus.SUCCESS else version

    def send(self, command: Command, payload: bytes = b"") -> int:
        """Send a request to the robot through the Franka Control Interface,
        and return the identifier of the request.
        """
        self._identifier += 1
        self.tcp.sendall(wire.message(self.protocol.code(command), self._identifier, payload))
        return self._identifier

    def answers(self) -> list[tuple[int, bytes]]:
        """Read once from the Franka client's connection,
        and return all complete answers as (identifier, payload).

        Raises:
            FciError: the robot closed the connection, or sends another protocol.
        """
        try:
            data = self.tcp.recv(65536)
        except TimeoutError:
            raise FciError("unreachable", f"{self.host} does not answer") from None
        except OSError as error:
            raise FciError("closed", f"the connection to {self.host} broke: {error.strerror}") from None
        if not data:
            raise FciError("closed", f"{self.host} closed the connection")
        self._received += data
        found = []
        try:
            while (message := wire.take_message(self._received)) is not None:
                found.append((message[1], message[2]))
        except WireError as error:
            raise FciError("protocol", f"{self.host} does not speak Franka's protocol: {error}") from None
        return found

    def ask(self, command: Command, payload: bytes = b"") -> bytes:
        """Send a request to the Franka robot and wait for the answer.
        Call this only while the robot stands still.

        Raises:
            FciError: no answer arrives.
        """
        try:
            identifier = self.send(command, payload)
        except OSError as error:
            raise FciError("closed", f"the connection to {self.host} broke: {error.strerror}") from None
        end = time.monotonic() + TIMEOUT
        while time.monotonic() < end:
            for answered, content in self.answers():
                if answered == identifier:
                    return content
        raise FciError("unreachable", f"{self.host} does not answer")

    def states(self) -> list[bytes]:
        """Return the state messages that the Franka client has already received, without waiting for more."""
        found = []
        while True:
            try:
                data, self._robot = self.udp.recvfrom(MAX_STATE + 1)
            except OSError:
                return found
            found.append(data)

    def first_state(self) -> bytes:
        """Wait for the first state message that the Franka robot sends to the client, and return it.

        Raises:
            FciError: none arrives.
        """
        if not select.select([self.udp], [], [], TIMEOUT)[0]:
            raise FciError(
                "unreachable", f"{self.host} sends no state to UDP port {self.udp.getsockname()[1]}"
            )
        data, self._robot = self.udp.recvfrom(MAX_STATE + 1)
        return data

    def command(self, data: bytes) -> None:
        """Send a message that commands a motion from the Franka client to the robot, over UDP."""
        if self._robot is not None:
            with contextlib.suppress(OSError):  # a full buffer: the robot misses one command
                self.udp.sendto(data, self._robot)

    def close(self) -> None:
        self.tcp.close()
        self.udp.close()
