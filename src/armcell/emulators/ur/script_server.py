"""Primary, secondary and real-time ports of the emulated UR controller.

They receive URScript, and send robot state and messages. Ports 30001 to 30003 accept programs; ports 30011 to
30013 send the same data and are read-only.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial

from armcell.drivers.ur.wire import robot_messages
from armcell.emulators.network import Network, TcpConnection
from armcell.emulators.ur.notices import Notice, Popup, ProgramState, SafetyChange, ScriptFault, TextMessage
from armcell.emulators.ur.programs import run_command, run_script
from armcell.emulators.ur.robot import Robot
from armcell.emulators.ur.state_messages import StateEncoder
from armcell.emulators.ur.urscript.parser import MAX_SCRIPT, depth_after

PORTS = PRIMARY, SECONDARY, REALTIME = 30001, 30002, 30003
READ_ONLY = 10  # offset of the read-only port's number
STATE_PERIOD = 0.1  # [s] between states on the primary and secondary ports
READ_ONLY_CODE = 210  # UR error code: commands over a read-only connection


@dataclass
class _Client:
    kind: int  # PRIMARY, SECONDARY or REALTIME
    read_only: bool
    lines: list[str] = field(default_factory=list)
    depth: int = 0


class ScriptServer:
    def __init__(
        self, robot: Robot, network: Network, host: str, ports: tuple[int, int, int] = PORTS
    ):  # fmt: skip
        self._robot, self._network, self._state = robot, network, StateEncoder(robot)
        self._clients: dict[TcpConnection, _Client] = {}
        self._next = 0.0
        self._popups = 0
        for name, kind, port in zip(("primary", "secondary", "real-time"), PORTS, ports, strict=True):
            for read_only in (False, True):
                begin = partial(self._begin, kind=kind, read_only=read_only)
                service = f"{name}, read-only" if read_only else f"script, {name}"
                number = port + READ_ONLY if read_only and port else port
                network.listen(host, number, begin, self._data, service)
        robot.listeners.append(self._announce)

    def _begin(self, link: TcpConnection, kind: int, read_only: bool) -> None:
        self._clients[link] = _Client(kind, read_only)
        if kind != REALTIME:
            v = self._robot.model.version
            link.send(robot_messages.version(self._state.now_us, "URControl", v[:3], v[3]))
            link.send(self._state.primary())

    def _data(self, link: TcpConnection) -> None:
        client = self._clients.get(link)
        if client is None:
            return
        while b"\n" in link.received:
            raw, _, rest = bytes(link.received).partition(b"\n")
            link.received[:] = rest
            line = raw.decode("utf-8", "replace").rstrip("\r")
            client.lines.append(line)
            client.depth = depth_after(line, client.depth)
            if client.depth == 0:
                text, client.lines = "\n".join(client.lines), []
                if text.strip():
                    self._run(link, client, text)
        if len(link.received) + sum(map(len, client.lines)) > MAX_SCRIPT:
            link.close()

    def _run(self, link: TcpConnection, client: _Client, text: str) -> None:
        robot = self._robot
        if robot.accepts_remote_commands and not client.read_only:
            if not run_command(robot, text):
                run_script(robot, self._network, text)
            return
        why = "this port is read-only" if client.read_only else "the robot is in local control"
        robot.popup(f"script refused: {why}")
        if client.kind == PRIMARY:
            level = robot_messages.WARNING
            link.send(robot_messages.error_code(self._state.now_us, READ_ONLY_CODE, 0, level, why))

    def _announce(self, notice: Notice) -> None:
        """Send a notice of the emulated UR robot to all clients on the primary port of the script server."""
        message = self._message(notice)
        for link, client in self._clients.items():
            if client.kind == PRIMARY:
                link.send(message)

    def _message(self, notice: Notice) -> bytes:
        now = self._state.now_us
        match notice:
            case TextMessage(text):
                return robot_messages.text(now, text)
            case ProgramState(started, name):
                return robot_messages.key(now, f"PROGRAM_XXX_{'STARTED' if started else 'STOPPED'}", name)
            case ScriptFault(_, line, column, code):
                return robot_messages.runtime_exception(now, line, column, code)
            case Popup(text, title, warning, error):
                self._popups += 1
                return robot_messages.popup(now, title, text, warning, error, self._popups)
            case SafetyChange(mode):
                return robot_messages.safety_mode(now, int(mode))

    def send_state(self) -> None:
        """Send states of the emulated UR robot to the script server's clients: every step to real-time
        clients, and at 10 Hz to primary and secondary clients.

        A client that does not read its data, such as ur_rtde's script client, is skipped while it is behind.
        """
        now = self._robot.time
        due = now >= self._next - 1e-9
        if due:
            self._next = max(self._next + STATE_PERIOD, now)
        slow = fast = b""
        for link, client in list(self._clients.items()):
            if not link.open:
                del self._clients[link]
            elif link.is_lagging:
                continue
            elif client.kind == REALTIME:
                fast = fast or self._state.realtime()
                link.send(fast)
            elif due:
                slow = slow or self._state.primary()
                link.send(slow)
