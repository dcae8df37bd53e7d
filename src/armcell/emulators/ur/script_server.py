"""Ports and pendant programs of the emulated UR controller that run programs as text; state messages.

They receive URScript, and send robot state and messages. Ports 30001 to 30003 accept programs; ports 30011 to
30013 send the same data and are read-only.

The host's script sender (port 50002 of UR's ROS drivers) receives the line `request_program` and answers with
URScript; that program then connects back to the host's reverse, trajectory and script command ports.

Source: UniversalRobots/Universal_Robots_Client_Library, doc/architecture/script_sender.rst.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from armcell.core import InputError
from armcell.drivers.ur.wire import primary, robot_messages
from armcell.drivers.ur.wire.modes import RuntimeState, SafetyMode
from armcell.emulators.network import Network, TcpConnection
from armcell.emulators.ur.builtins import motion_functions, value_functions
from armcell.emulators.ur.builtins_data import DigitalOutputs, socket_functions
from armcell.emulators.ur.notices import Notice, Popup, ProgramState, SafetyChange, ScriptFault, TextMessage
from armcell.emulators.ur.robot import Robot
from armcell.emulators.ur.rtde_server import outputs_of
from armcell.emulators.ur.urscript import Machine, ScriptError
from armcell.emulators.ur.urscript.parser import MAX_SCRIPT, depth_after

REALTIME_DOUBLES = (((3, 15), 152), ((3, 14), 142), ((3, 10), 139), ((3, 5), 138), ((3, 2), 132))

"""Number of doubles in the real-time message, by the first CB3 software version that sends it."""

_REALTIME = (
    (0, "timestamp"), (1, "target_q"), (7, "target_qd"), (13, "target_qdd"), (19, "target_current"),
    (25, "target_moment"), (31, "actual_q"), (37, "actual_qd"), (43, "actual_current"),
    (49, "joint_control_output"), (55, "actual_TCP_pose"), (61, "actual_TCP_speed"),
    (67, "actual_TCP_force"), (73, "target_TCP_pose"), (79, "target_TCP_speed"),
    (85, "actual_digital_input_bits"), (86, "joint_temperatures"), (92, "actual_execution_time"),
    (94, "robot_mode"), (95, "joint_mode"), (101, "safety_mode"), (108, "actual_tool_accelerometer"),
    (117, "speed_scaling"), (118, "actual_momentum"), (121, "actual_main_voltage"),
    (122, "actual_robot_voltage"), (123, "actual_robot_current"), (124, "actual_joint_voltage"),
    (130, "actual_digital_output_bits"), (131, "runtime_state"), (132, "elbow_position"),
    (135, "elbow_velocity"), (138, "safety_status"), (142, "payload"), (143, "payload_cog"),
    (146, "payload_inertia"),
)  # fmt: skip

"""Index of each value's first double. Source: Universal Robots, "Realtime Client Interface" (3.15, 5.10)."""

READ_ONLY = 10  # offset of the read-only port's number

STATE_PERIOD = 0.1  # [s] between states on the primary and secondary ports

READ_ONLY_CODE = 210  # UR error code: commands over a read-only connection


class StateEncoder:
    """Encoder of the state messages that the script server of an emulated UR robot sends to its clients."""

    def __init__(self, robot: Robot):
        self._robot, self._read = robot, outputs_of(robot)
        self._doubles = next(n for since, n in REALTIME_DOUBLES if robot.model.cb3_version >= since)

    @property
    def now_us(self) -> int:
        return int(self._robot.time * 1e6)

    def realtime(self) -> bytes:
        values = np.zeros(max(n for _, n in REALTIME_DOUBLES), dtype=">f8")
        for first, name in _REALTIME:
            value = self._read[name]()
            place = first if np.isscalar(value) else slice(first, first + len(value))
            values[place] = value
        return struct.pack(">i", 4 + 8 * self._doubles) + values[: self._doubles].tobytes()

    def primary(self) -> bytes:
        """Return the state message that the script server sends to primary clients of the emulated UR robot,
        with every package that the robot model sends.
        """
        r = self._robot
        rows = zip(
            *(self._six(name) for name in ("actual_q", "target_q", "actual_qd", "actual_current")),
            *(self._six(name) for name in ("actual_joint_voltage", "joint_temperatures")),
            (int(x) for x in self._read["joint_mode"]()),
            strict=True,
        )
        tool_mode = int(self._read["tool_mode"]())
        domains = (r.analog_volts & 1, r.analog_volts >> 1 & 1)
        packages = [
            self._mode(),
            primary.joint_package(rows),
            primary.tool_package((self._read["tool_analog_input0"](), 0.0), r.tool_voltage, 25.0, tool_mode),
            primary.masterboard_package(
                r.digital_in, r.digital_out, domains, (r.analog_output(0), r.analog_output(1)),
                int(r.safety), r.safety is SafetyMode.REDUCED,
            ),
            primary.cartesian_package(self._six("actual_TCP_pose"), r.setpoint.tcp),
            r.dh.pack(),
            self._configuration(),
            primary.force_mode_package(r.external_wrench().tolist(), 1.0),
            primary.additional_package(r.compliance is not None and r.compliance.freedrive),
            *primary.internal_packages(),
        ]  # fmt: skip
        if r.model.e_series:
            packages += primary.tool_extras(0)
        return primary.robot_state(packages)

    def _six(self, name: str) -> list[float]:
        return [float(x) for x in self._read[name]()]

    def _mode(self) -> bytes:
        r = self._robot
        return primary.mode_package(
            self.now_us, r.mode >= 4, r.safety in (6, 7), r.safety is SafetyMode.PROTECTIVE_STOP,
            r.runtime is RuntimeState.PLAYING, r.runtime is RuntimeState.PAUSED,
            max(int(r.mode), 0), r.slider, r.scaling, r.model.cb3_version,
        )  # fmt: skip

    def _configuration(self) -> bytes:
        r, limit = self._robot, self._robot.model.max_position
        kind = primary.ROBOT_TYPES[r.model.name.removesuffix("e")]
        return primary.configuration_package(
            [(-limit, limit)] * 6, r.model.velocity, [r.model.acceleration] * 6, r.dh, kind
        )


def run_command(robot: Robot, text: str) -> bool:
    """Execute a text command from a client of the script server that is not URScript, such as `stop program`,
    on the emulated UR robot.

    Returns:
        False if the text is not a command.
    """
    commands: dict[str, Callable[[], object]] = {
        "stop program": robot.end_program,
        "pause program": robot.pause,
        "resume program": robot.play,
        "power on": robot.power_on,
        "power off": robot.power_off,
        "set robotmode run": robot.release_brakes,
        "set robotmode powerdown": robot.power_off,
        "set unlock protective stop": robot.unlock,
        "set sim": lambda: None,
        "set real": lambda: None,
    }
    command = commands.get(" ".join(text.split()))
    if command is None:
        return False
    command()
    return True


def run_script(robot: Robot, network: Network, text: str, name: str = "") -> bool:
    """Take a URScript program that a client sent to the script server, compile it, and start it on the
    emulated UR robot in place of the running program.

    A secondary program runs beside the running program. If the text does not compile, the robot reports the
    error as a pendant does, and the running program ends as well.

    Args:
        name: program name that overrides the name in the text.
    Returns:
        Whether the program started.
    """
    waiting, instant, close_sockets = socket_functions(robot, network)
    try:
        machine = Machine(text, motion_functions(robot) | waiting, value_functions(robot) | instant)
    except (ScriptError, SyntaxError, RecursionError) as error:
        robot.end_program()
        robot.report_program_error(error if isinstance(error, ScriptError) else ScriptError(str(error)))
        return False
    if machine.secondary:
        robot.run_secondary(machine)
        close_sockets()
        return True
    machine.variables["digital_out"] = DigitalOutputs(robot)
    machine.name = name or machine.name
    robot.run(machine)
    robot.on_program_end(close_sockets)
    return robot.machine is machine


PORTS = PRIMARY, SECONDARY, REALTIME = 30001, 30002, 30003


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
        """Send a message about an event of the emulated UR robot, such as a popup, to all primary clients of
        the script server.
        """
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


NAME = "external_control.urp"

SCRIPT_SENDER = 50002

LAST_LINE = b"# NODE_CONTROL_LOOP_ENDS"

PATIENCE = 2.0  # [s] to wait for the first byte

SILENCE = 0.3  # [s] without another byte before the text counts as complete


@dataclass(frozen=True)
class RemoteHost:
    """Address of the remote server from which the URCap External Control requests its script, as entered on
    the URCap's installation page.
    """

    address: str
    port: int = SCRIPT_SENDER

    @staticmethod
    def parse(text: str) -> RemoteHost:
        """Parse the address of the server from which External Control requests its script: ADDRESS or
        ADDRESS:PORT.

        Raises:
            InputError: the text has neither form.
        """
        address, _, port = text.partition(":")
        if not address or (port and not (port.isdigit() and 0 < int(port) < 65536)):
            raise InputError(f"{text!r} is no address of a script sender", hint="such as 127.0.0.1:50002")
        return RemoteHost(address, int(port) if port else SCRIPT_SENDER)


class ExternalControl:
    """Emulated program `external_control.urp` of the pendant, which requests its script from a remote server.
    A dashboard client loads and plays it.
    """

    def __init__(self, robot: Robot, network: Network, remote: RemoteHost | None):
        self._robot, self._network, self._remote = robot, network, remote
        self.loaded = False
        self._link: TcpConnection | None = None
        self._size, self._since = 0, 0.0

    def load(self, name: str) -> bool:
        """Load the External Control program, which runs a script from a remote server. Return False if `name`
        is another program or if the remote host is not set.
        """
        if self._remote is None or name.rsplit("/", 1)[-1] != NAME:
            return False
        self._robot.end_program()
        self.loaded = True
        return True

    def play(self) -> bool:
        """Request the script for External Control from the remote server. Return False if that fails.

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
        """Stop waiting for the script that External Control has requested from the remote server."""
        if self._link is not None:
            self._link.close()
            self._link = None

    def step(self) -> None:
        """Receive the script for External Control from the remote server, and start the script once it is
        complete.

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
