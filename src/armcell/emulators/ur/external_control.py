"""Emulated URCap "External Control": a pendant program whose text comes from a host.

The host's script sender (port 50002 of UR's ROS drivers) receives the line `request_program` and answers with
URScript; that program then connects back to the host's reverse, trajectory and script command ports.

Source: UniversalRobots/Universal_Robots_Client_Library, doc/architecture/script_sender.rst.
"""

from __future__ import annotations

from dataclasses import dataclass

from armcell.core import InputError
from armcell.emulators.network import Network, TcpConnection
from armcell.emulators.ur.robot import Robot
from armcell.emulators.ur.script_server import run_script
from armcell.emulators.ur.urscript.parser import MAX_SCRIPT

NAME = "external_control.urp"
SCRIPT_SENDER = 50002
LAST_LINE = b"# NODE_CONTROL_LOOP_ENDS"
PATIENCE = 2.0  # [s] to wait for the first byte
SILENCE = 0.3  # [s] without another byte before the text counts as complete


@dataclass(frozen=True)
class RemoteHost:
    """Address of the program that sends scripts to External Control,
    as entered on the installation page of the URCap.
    """

    address: str
    port: int = SCRIPT_SENDER

    @staticmethod
    def parse(text: str) -> RemoteHost:
        """Parse the address from which the URCap External Control gets scripts: ADDRESS or ADDRESS:PORT.

        Raises:
            InputError: the text has neither form.
        """
        address, _, port = text.partition(":")
        if not address or (port and not (port.isdigit() and 0 < int(port) < 65536)):
            raise InputError(f"{text!r} is no address of a script sender", hint="such as 127.0.0.1:50002")
        return RemoteHost(address, int(port) if port else SCRIPT_SENDER)


class ExternalControl:
    """Emulated program `external_control.urp`, which a dashboard client loads and plays."""

    def __init__(self, robot: Robot, network: Network, remote: RemoteHost | None):
        self._robot, self._network, self._remote = robot, network, remote
        self.loaded = False
        self._link: TcpConnection | None = None
        self._size, self._since = 0, 0.0

    def load(self, name: str) -> bool:
        """Load the External Control program. Return False if `name` is another program or if the remote host
        is not set.
        """
        if self._remote is None or name.rsplit("/", 1)[-1] != NAME:
            return False
        self._robot.end_program()
        self.loaded = True
        return True

    def play(self) -> bool:
        """Request the program text for External Control from the remote host. Return False if that fails.

        The program starts when its text has arrived.
        """
        if (
            not self.loaded
            or self._remote is None
            or not self._robot.can_run_program
            or self._robot.machine is not None
        ):
            return False
        self.stop()
        link = self._network.connect(self._remote.address, self._remote.port)
        if link is None:
            self._robot.popup(
                f"External Control: no host at {self._remote.address}:{self._remote.port} sends a program"
            )
            return False
        link.send(b"request_program\n")
        self._link, self._size, self._since = link, 0, self._robot.time
        return True

    def stop(self) -> None:
        """Stop waiting for the program text that External Control has requested from the remote host."""
        if self._link is not None:
            self._link.close()
            self._link = None

    def step(self) -> None:
        """Receive the program text for External Control, and start the program once the text is complete.

        Call this method once per control step.
        """
        link, now = self._link, self._robot.time
        if link is None:
            return
        if len(link.received) != self._size:
            self._size, self._since = len(link.received), now
        silent = now - self._since > (SILENCE if self._size else PATIENCE)
        if not (silent or not link.open or LAST_LINE in link.received or self._size > MAX_SCRIPT):
            return
        text = bytes(link.received).decode("utf-8", "replace")
        self.stop()
        if not text.strip():
            self._robot.popup("External Control: no program came")
        else:
            run_script(self._robot, self._network, text, NAME)
