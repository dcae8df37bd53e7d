"""`armcell serve`: serve a cell to Unity and ROS; `armcell sim`: a cell in Unity's place."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import typer
from rich.live import Live
from rich.text import Text

from armcell import _interrupts
from armcell.cli.common_options import SEED, seed_or_default
from armcell.cli.console import console, err, errors, print_addresses
from armcell.cli.gate import WITHOUT_GATE, require_gate_override
from armcell.cli.ros_options import (
    ARGUMENTS,
    DOMAIN,
    NAMESPACE,
    OWN_MASTER,
    REMAP,
    ROS1,
    ROS2,
    Join,
    OpenTransport,
    RosNameOptions,
    check_domain,
    check_own_master,
    join_ros1,
    join_ros2,
    parse_ros_names,
    reserve_transport,
    unused_remappings_warning,
)
from armcell.cli.run_record import (
    RECORD,
    RUNS,
    ExternallyControlledRun,
    RecordingOptions,
    error_text,
    records_folder,
)
from armcell.core import InputError

REFRESH = 1.0  # [s]
CELL = typer.Argument(..., help="Built-in cell (see `armcell cells`), folder with cell.yaml, or YAML file.")
MODE = typer.Option("sim", help="sim: physics. fake: follows every command exactly, no physics.")
SCALE = typer.Option(1.0, "--time-scale", min=0.001, help="1: real time, 0.2: slow motion.")
HERTZ = 30.0
RATE = typer.Option(
    HERTZ,
    min=1.0,
    max=1000.0,
    help="Hz of the states, in the cell's time; at most 250 in physics, 100 in mode fake.",
)
AUTO_GRIP = typer.Option(
    False, "--auto-grip", help="A gripper closes where the arm rests with an object between its fingers."
)
SECONDS = typer.Option(None, "--for", metavar="SECONDS", min=0.1, help="End by itself after so long.")


@dataclass(frozen=True)
class _Served:
    """Options of `armcell serve` for the cell that it serves.

    Attributes:
        command: the command line up to the options of the cell.
        runs: folder of run folders; None for no record.
    """

    command: tuple[str, ...]
    cell: str
    mode: str
    seed: int | None
    time_scale: float
    rate: float
    seconds: float | None
    runs: Path | None
    without_gate: str | None
    names: RosNameOptions


def serve(
    cell: str = CELL,
    arguments: list[str] = ARGUMENTS,
    unity: bool = typer.Option(False, "--unity", help="Serve Unity's ROS-TCP-Connector."),
    ros1: bool = ROS1,
    own_master: bool | None = OWN_MASTER,
    ros2: bool = ROS2,
    domain: int | None = DOMAIN,
    ns: str = NAMESPACE,
    remap: list[str] | None = REMAP,
    port: int = typer.Option(10000, min=0, max=65535, help="Port for Unity; 0: any free one."),
    bind: str | None = typer.Option(
        None, help="Address to listen on: 127.0.0.1, for ROS 1 what ROS_IP says; 0.0.0.0 lets others in."
    ),
    protocol: str = typer.Option("auto", help="auto (as each client speaks), ROS1 or ROS2."),
    mode: str = MODE,
    seed: int | None = SEED,
    time_scale: float = SCALE,
    rate: float = RATE,
    wire: list[str] | None = typer.Option(
        None, metavar="NAME[=ADDRESS]", help="Open a transport by name, for example of an installed package."
    ),
    types: Path | None = typer.Option(
        None, metavar="FOLDER", help="Own message definitions: FOLDER/<package>/msg/<Name>.msg"
    ),
    plan_only: bool = typer.Option(
        False,
        "--plan-only",
        help="The robot or simulator is a client (Unity, `armcell sim`, ros2_control): "
        "plan and grasp with it, through the cell file's controllers where it names any.",
    ),
    sensors: Path | None = typer.Option(
        None, metavar="FILE", help="MoveIt's sensors_3d.yaml: clouds and depth images that make the octomap."
    ),
    auto_grip: bool = AUTO_GRIP,
    seconds: float | None = SECONDS,
    record: bool | None = RECORD,
    runs: Path | None = RUNS,
    without_gate: str | None = WITHOUT_GATE,
) -> int:
    """Run a cell and serve it to other programs.
    The cell publishes its states and accepts trajectories, planning, pick and place.

    Unity connects to the port with its ROS-TCP-Connector, in ROS 1 or ROS 2 mode. With --ros1, ROS programs
    see a node that publishes, plans and moves as MoveIt's move_group does; with --ros2, ROS 2 programs do.
    Ctrl-C ends the command.
    """
    if not (unity or ros1 or ros2 or wire):
        raise InputError("nothing to serve", hint="give --unity, --ros1, --ros2 or --wire")
    if plan_only and record:
        raise InputError(
            "--plan-only has nothing to record: the simulator is elsewhere", hint="record there: armcell sim"
        )
    check_own_master(ros1, own_master)
    names = parse_ros_names(ns, remap, arguments, ros1)
    check_domain(ros2, domain)
    from armcell.perception import load_sensors_3d
    from armcell.ros import Bus, Schema

    watched = None if sensors is None else load_sensors_3d(sensors)
    bus = Bus(Schema(types) if types is not None else None)
    with ExitStack() as stack:  # report a port in use before the cell is loaded
        joins: list[Join] = []
        if unity:
            joins.append(serve_unity(stack, bus, bind or "127.0.0.1", port, protocol))
        if ros1:
            joins.append(join_ros1(stack, bus, "armcell", own_master, names, bind))
        if ros2:
            joins.append(join_ros2(stack, bus, "armcell", domain, bind, names.namespace))
        joins += [open_wire(stack, bus, each) for each in wire or ()]
        wires = _Wires(joins)
        if plan_only:
            return _plan_only(cell, bus, names, seed or 0, seconds, wires.status, wires.open, watched)
        wanted = {"--unity": unity, "--ros1": ros1, "--ros2": ros2, "--auto-grip": auto_grip}
        command = ("serve", cell, *(flag for flag, given in wanted.items() if given))
        command += tuple(word for each in wire or () for word in ("--wire", each))
        command += ("--types", str(types)) if types is not None else ()
        command += ("--sensors", str(sensors)) if sensors is not None else ()
        kept = records_folder(record, mode, runs)
        served = _Served(command, cell, mode, seed, time_scale, rate, seconds, kept, without_gate, names)
        return _run(served, bus, wires.status, wires.open, True, auto_grip, watched)


class _Wires:
    """Connections of `armcell serve` to Unity and ROS, which stay closed until the cell is ready."""

    def __init__(self, joins: Sequence[Join]):
        self._joins = joins
        self._wires: list[OpenTransport] = []

    def open(self, bus: Any = None) -> None:
        """Open the connections of `armcell serve`, and print their addresses."""
        for join in self._joins:
            wire = join()
            self._wires.append(wire)
            console.print(f"{wire.ready}; Ctrl-C ends it", markup=False, soft_wrap=True)
            print_addresses(wire.endpoints)

    def status(self) -> str:
        return "  ".join(wire.status() for wire in self._wires)


def serve_unity(stack: ExitStack, bus: Any, bind: str, port: int, protocol: str) -> Join:
    """Reserve a TCP port for the connection to Unity, and return a function that opens this connection.
    `stack` frees the port when `armcell serve` ends.
    """
    from armcell.ros.transports import TcpTransport

    connect = reserve_transport(stack, TcpTransport(bus, f"{bind}:{port}", protocol))
    if bind not in ("127.0.0.1", "localhost"):
        err(f"{bind}: every machine in the network can move the cell (no password, no encryption)")
    return connect


def open_wire(stack: ExitStack, bus: Any, wire: str) -> Join:
    """Reserve the connection that the option `--wire` of `armcell serve` requests. The argument `wire` is a
    transport's NAME or NAME=ADDRESS.

    Raises:
        UnknownNameError: no such transport.
        InputError: the address is invalid or in use.
    """
    from armcell.ros.transports import transports

    name, _, where = wire.partition("=")
    return reserve_transport(stack, transports[name](bus, where))


def sim(
    cell: str = CELL,
    arguments: list[str] = ARGUMENTS,
    connect: str | None = typer.Option(
        None, metavar="HOST:PORT", help="A ROS-TCP endpoint, e.g. 127.0.0.1:10000."
    ),
    ros1: bool = ROS1,
    own_master: bool | None = OWN_MASTER,
    ros2: bool = ROS2,
    domain: int | None = DOMAIN,
    ns: str = NAMESPACE,
    remap: list[str] | None = REMAP,
    protocol: str = typer.Option("ROS1", help="Of an endpoint older than 0.7; later ones say it themselves."),
    mode: str = MODE,
    seed: int | None = SEED,
    time_scale: float = SCALE,
    rate: float = RATE,
    auto_grip: bool = AUTO_GRIP,
    seconds: float | None = SECONDS,
    record: bool | None = RECORD,
    runs: Path | None = RUNS,
    without_gate: str | None = WITHOUT_GATE,
) -> int:
    """Serve a cell in place of Unity until Ctrl-C. The cell connects to a ROS-TCP endpoint as Unity would.

    With --ros1 or --ros2, the cell is a node that publishes states and takes trajectories and gripper
    commands.
    """
    check_own_master(ros1, own_master)
    names = parse_ros_names(ns, remap, arguments, ros1)
    check_domain(ros2, domain)
    if (ros1 or ros2) == (connect is not None):
        raise InputError("where to?", hint="give either --connect HOST:PORT, or --ros1 or --ros2")
    to = ("--connect", connect) if connect else ("--ros1",) * ros1 + ("--ros2",) * ros2
    kept = records_folder(record, mode, runs)
    to += ("--auto-grip",) * auto_grip
    served = _Served(
        ("sim", cell, *to), cell, mode, seed, time_scale, rate, seconds, kept, without_gate, names
    )
    from armcell.ros import Bus

    if connect is None:
        bus = Bus()
        with ExitStack() as stack:
            joins: list[Join] = []
            if ros1:
                joins.append(join_ros1(stack, bus, "armcell_sim", own_master, names, None))
            if ros2:
                joins.append(join_ros2(stack, bus, "armcell_sim", domain, None, names.namespace))
            wires = _Wires(joins)
            return _run(served, bus, wires.status, wires.open, auto_grip=auto_grip)
    from armcell.ros.codec import CODECS
    from armcell.ros.nodes.cell_node import STATUS, TRAJECTORY
    from armcell.ros.nodes.gripper_node import TOPIC as GRIPPER
    from armcell.ros.tcp import ForwardedNames, RosTcpClient
    from armcell.ros.transports import losses

    host, number = address(connect)
    if protocol not in CODECS:
        raise InputError(f"protocol is {protocol!r}", hint="ROS1 or ROS2")
    bus = Bus()
    client: RosTcpClient | None = None

    def joined(inside: Any) -> None:
        """Connect the cell that `armcell sim` serves to the ROS-TCP endpoint. This happens after the cell has
        started to publish, when all its topics are known.
        """
        nonlocal client
        kept = ("/clock", "/joint_states", "/tf", STATUS)
        topics = inside.topics()
        out = [t for t in topics if t.name in kept or t.name.startswith("/object_pose")]
        into = [t for t in topics if t.name == TRAJECTORY or t.name.endswith(GRIPPER)]
        publish, subscribe = ({inside.full_name(t.name): t.type for t in some} for some in (out, into))
        client = RosTcpClient(bus, host, number, ForwardedNames(publish, subscribe), protocol)
        client.start()

    def status() -> str:
        peer = client.connection if client else None
        if client is None or peer is None or not client.wait_connected(0):
            return f"connecting to {host}:{number}"
        return f"at {host}:{number}" + losses(sum(peer.link.outbox.dropped.values()), peer.complaints.total)

    try:
        return _run(served, bus, status, joined, auto_grip=auto_grip)
    finally:
        if client is not None:
            client.close()


def address(text: str) -> tuple[str, int]:
    """Parse the address HOST:PORT of the ROS-TCP endpoint to which `armcell sim` serves a cell. Return the
    host and the port.

    Raises:
        InputError: the text does not have this form, or the port is out of range.
    """
    host, _, port = text.rpartition(":")
    if not host or not port.isdigit() or not 0 < int(port) < 65536:
        raise InputError(f"{text!r} is no address", hint="HOST:PORT, for instance 127.0.0.1:10000")
    return host, int(port)


def _run(
    what: _Served, bus: Any, status: Callable[[], str], ready: Callable[[Any], None], plan: bool = False,
    auto_grip: bool = False, sensors: Any = None,
) -> int:  # fmt: skip
    from armcell.cell.health import first_layers
    from armcell.ros.nodes import ServedCell

    mode, seed = what.mode, seed_or_default(what.seed, what.mode)
    gate = require_gate_override(mode, "what clients do", what.without_gate)
    tell = partial(errors.print, markup=False, highlight=False)
    loaded, health = first_layers(what.cell, mode, tell)
    scene = loaded.scene(seed)
    command = ["armcell", *what.command, "--mode", mode, *([] if seed is None else ["--seed", str(seed)])]
    command += [] if what.time_scale == 1.0 else ["--time-scale", f"{what.time_scale:g}"]
    command += [] if what.rate == HERTZ else ["--rate", f"{what.rate:g}"]
    command += what.names.command_line
    command += ["--without-gate", str(what.without_gate)] if gate else []
    by = "those who join the cell"
    with ExternallyControlledRun(
        loaded, scene, seed, mode, RecordingOptions(what.runs), {}, by, command, gate=gate
    ) as run:
        live = loaded.connect(mode, seed, run.observers, what.time_scale)
        run.begin(live)
        inside = bus.with_remapping(what.names.map_for(loaded))
        served = ServedCell(live, inside, what.rate, plan, auto_grip, sensors)

        def all_status() -> str:
            ill = [f"{n} {s}" for n, s in health.now(live).items() if n != "task" and s != "ok"]
            return "  ".join([status(), *ill])

        line = _StatusLine(inside, lambda: served.node.executed, all_status, served.node.cameras.frames)
        failure: BaseException | None = None
        try:
            served.start(layer=health.layer)
            ready(inside)
            _tell_unused(inside)
            with line:
                _until(what.seconds, line, served.over)
        except KeyboardInterrupt:
            if not served.node.ready.is_set():
                raise
            _interrupts.take_time()
        except BaseException as error:
            failure = error
            raise
        finally:
            try:
                if served.node.ready.is_set():
                    served.stop_motions()
                    run.end(served.call, live, error_text(served.failure or failure))
            finally:
                served.close()
        if served.failure is not None:
            raise served.failure
    return 0


def _plan_only(
    cell: str,
    bus: Any,
    names: RosNameOptions,
    seed: int,
    seconds: float | None,
    status: Callable[[], str],
    ready: Callable[[], None],
    sensors: Any = None,
) -> int:
    from armcell.cell import load
    from armcell.ros.nodes import ServedPlanner

    loaded = load(cell)
    inside = bus.with_remapping(names.map_for(loaded))
    line = _StatusLine(inside, lambda: None, status)
    try:
        with ServedPlanner(loaded, inside, seed, sensors):
            ready()
            for each in loaded.controllers:
                text = f"Drives {each.name}: {each.type} {each.topic} ({', '.join(each.joints)})"
                console.print(text, markup=False, soft_wrap=True)
            _tell_unused(inside)
            with line:
                _until(seconds, line, None)
    except KeyboardInterrupt:
        _interrupts.take_time()
    return 0


def _tell_unused(bus: Any) -> None:
    if odd := unused_remappings_warning(bus):
        err(odd)


def _until(seconds: float | None, line: _StatusLine, over: threading.Event | None) -> None:
    """Show the status line of `armcell serve` until the time is up or the cell has ended."""
    end = None if seconds is None else time.monotonic() + seconds
    while (over is None or not over.is_set()) and (end is None or time.monotonic() < end):
        line.show()
        left = REFRESH if end is None else max(min(REFRESH, end - time.monotonic()), 0.0)
        if over is None:
            _interrupts.sleep(left)
        else:
            _interrupts.wait(over.wait, left)


class _StatusLine:
    """Status line of `armcell serve`.
    On a terminal it is updated in place, else it is printed when the peers change.
    """

    def __init__(
        self, bus: Any, executed: Callable[[], int | None], status: Callable[[], str],
        frames: Callable[[], dict[str, int]] = dict,
    ):  # fmt: skip
        self._bus, self._executed, self._status, self._frames = bus, executed, status, frames
        self._delivered: dict[str, int] = {}
        self._live = Live(console=errors, transient=True, auto_refresh=False) if errors.is_terminal else None
        self._counts: dict[str, int] = {}
        self._at = (time.monotonic(), bus.clock.now())
        self._said = ""

    def __enter__(self) -> _StatusLine:
        if self._live:
            self._live.start()
        return self

    def __exit__(self, *exc: object) -> None:
        if self._live:
            self._live.stop()

    def show(self) -> None:
        peers = self._status()
        if self._live:
            self._live.update(
                Text(f"{peers}  {self._numbers()}", overflow="ellipsis", no_wrap=True), refresh=True
            )
        elif peers != self._said:
            console.print(peers, markup=False)
        self._said = peers

    def _numbers(self) -> str:
        now, clock = time.monotonic(), self._bus.clock.now()
        passed = max(now - self._at[0], 1e-3)
        pace = (clock - self._at[1]) / passed
        topics = self._bus.topics()
        delivered = self._frames()
        rates = [
            f"{camera} {(count - self._delivered.get(camera, 0)) / passed:.1f} frames/s"
            for camera, count in delivered.items()
            if count > self._delivered.get(camera, 0)
        ]
        self._delivered = delivered
        for topic in topics:
            rate = (topic.messages - self._counts.get(topic.name, 0)) / passed
            if rate > 0.5 and topic.name in ("/joint_states", "/tf", "/object_pose"):
                rates.append(f"{topic.name} {rate:.0f} Hz")
        self._counts = {t.name: t.messages for t in topics}
        self._at = (now, clock)
        executed = self._executed()
        played = "" if executed is None else f"  trajectories {executed}"
        return f"t {clock:.1f} s ({pace:.2f}x)  {'  '.join(rates)}{played}"
