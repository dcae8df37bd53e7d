"""`armcell run SCRIPT.py` and its connections to Unity, ROS 1 and ROS 2; `armcell lint`: check a script."""

from __future__ import annotations

import json
import logging
import os
import re
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from typer.core import TyperCommand

from armcell import _interrupts
from armcell.cli.console import console, err, errors, print_addresses
from armcell.cli.gate import require_gate_override
from armcell.cli.page import PageAddress, print_page_address
from armcell.cli.ros_options import (
    Join,
    RosNameOptions,
    check_domain,
    check_own_master,
    unused_remappings_warning,
)
from armcell.cli.run_record import ExternallyControlledRun, RecordingOptions, error_text
from armcell.core import InputError

if TYPE_CHECKING:
    from armcell.moveit.session import Session
    from armcell.ros import Ros1Settings

UNITY = "127.0.0.1:10000"
ADDRESS = re.compile(r"[\w.-]+:\d+")
LOOK = 0.1  # [s] between two checks whether the other end publishes


class UnityCommand(TyperCommand):
    """Typer command for ROS scripts, with the connection option `--unity`. The value HOST:PORT of the option
    can be omitted.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        full: list[str] = []
        for i, word in enumerate(args):
            if word == "--":
                return super().parse_args(ctx, [*full, *args[i:]])
            full.append(word)
            if word == "--unity" and not ADDRESS.fullmatch((args[i + 1 :] or [""])[0]):
                full.append(UNITY)
        return super().parse_args(ctx, full)


@dataclass(frozen=True)
class ScriptConnections:
    """Connections that a ROS script and its cell open to other programs: Unity, ROS 1 and ROS 2.

    Attributes:
        unity: HOST:PORT of the ROS-TCP endpoint, or None.
        ros1, own_master: join a ROS 1 graph; see `join_ros1` in ros_options.py.
        ros2, domain: join a ROS 2 domain, instead of ROS_DOMAIN_ID.
        plan_only: the script controls a simulator or robot at the other end of the connection.
        names: namespace and remappings of the cell's and the script's names.
    """

    unity: str | None = None
    ros1: bool = False
    own_master: bool | None = None
    ros2: bool = False
    domain: int | None = None
    plan_only: bool = False
    names: RosNameOptions = RosNameOptions("", (), ())

    @property
    def given(self) -> bool:
        return self != ScriptConnections()

    def check(self) -> None:
        """Check that the options for a ROS script's connections to Unity, ROS 1 and ROS 2 are consistent.

        Raises:
            InputError: the options do not go together.
        """
        check_own_master(self.ros1, self.own_master)
        check_domain(self.ros2, self.domain)
        if self.plan_only and not (self.unity or self.ros1 or self.ros2):
            raise InputError(
                "--plan-only needs a wire to the simulator or robot", hint="add --unity, --ros1 or --ros2"
            )
        if self.names.command_line and not (self.unity or self.ros1 or self.ros2):
            raise InputError(
                f"{self.names.command_line[0]} needs a wire to other programs",
                hint="add --unity, --ros1 or --ros2",
            )

    def words(self) -> list[str]:
        """Return the options for a script's connections (Unity, ROS
        1, ROS 2) in the form of a command line.
        """
        return [
            *(("--unity", self.unity) if self.unity else ()),
            *(["--ros1"] if self.ros1 else []),
            *(["--ros2"] if self.ros2 else []),
            *(["--plan-only"] if self.plan_only else []),
            *self.names.command_line,
        ]

    def reserve(self, stack: ExitStack, bus: Any) -> list[Join]:
        """Reserve the connections of a script (the ports for Unity and ROS 2),
        and return the functions that open them.

        The script session itself joins ROS 1.

        Raises:
            InputError: a port is in use, or an address or environment variable is wrong.
        """
        from armcell.cli.ros_options import join_ros2
        from armcell.cli.serve import address, serve_unity

        found: list[Join] = []
        if self.unity:
            host, port = address(self.unity)
            found.append(serve_unity(stack, bus, host, port, "auto"))
        if self.ros2:
            found.append(join_ros2(stack, bus, "armcell", self.domain, namespace=self.names.namespace))
        return found

    def open(self, session: Session, joins: Sequence[Join]) -> None:
        """Connect the cell of a script to other programs, such as ROS nodes. With --plan-only, also wait for
        the joint states of the simulator or robot.
        """
        from armcell.ros.nodes import ServedPlanner

        if session.graph is not None:
            print_addresses(session.graph.endpoints(), errors)  # standard output belongs to the script
        for join in joins:
            wire = join()
            errors.print(wire.ready, markup=False, highlight=False, soft_wrap=True)
            print_addresses(wire.endpoints, errors)
        if odd := unused_remappings_warning(session.bus):
            err(odd)
        if not isinstance(session.served, ServedPlanner):
            return
        robot = session.served.driver
        if not robot.has_joint_states:
            err(f"waiting for /joint_states of the simulator or robot ({self._how()})")
        while not robot.has_joint_states:
            _interrupts.sleep(LOOK)

    def _how(self) -> str:
        if self.unity:
            return f"Unity, or `armcell sim CELL --connect {self.unity}`"
        return f"its own node, or `armcell sim CELL --ros{1 if self.ros1 else 2}`"


def run_script_command(
    script: str,
    cell: str | None,
    arguments: list[str],
    seed: int | None,
    mode: str,
    time_scale: float | None,
    auto_grip: bool | None,
    view: bool,
    at: PageAddress,
    without_gate: str | None,
    kept: RecordingOptions,
    set_: Sequence[str] = (),
    wires: ScriptConnections = ScriptConnections(),
    gains: str | None = None,
) -> int:
    """Run a ROS script unchanged in a cell, as the command line requests,
    and return the exit status of the script.

    With `wires.ros1`, script and cell join a ROS 1 graph, and arguments of the form from:=to are remappings.
    """
    wires.check()
    if cell is None:
        raise InputError(f"no cell for {script}", hint="--cell CELL; `armcell cells` lists the built-in ones")
    file = Path(script)
    if not os.path.isfile(file):
        raise InputError("there is no such script", file=file)
    if wires.plan_only:
        refused = {
            "--view": view,
            "--json": kept.json_file,
            "--frames": kept.frames,
            "--auto-grip": auto_grip,
            "--gains": gains,
        }
        for option in (name for name, value in refused.items() if value):
            raise InputError(
                f"{option} needs a robot in this process", hint="give it to the other end: armcell sim"
            )
        return _run_elsewhere(file, cell, arguments, wires, set_)
    from armcell.cell import gains_as_values, load, parse_value, run_failures, with_values
    from armcell.drivers import drivers
    from armcell.moveit import run_script
    from armcell.moveit.lint import closes_gripper_itself
    from armcell.ros import Bus

    drivers[mode]  # report an unknown mode first
    gate = require_gate_override(mode, f"what {file.name} does", without_gate)
    gripping = auto_grip
    if auto_grip is None:
        auto_grip = not closes_gripper_itself(file)
        if auto_grip:
            err(
                f"{file.name} commands no gripper: it closes by itself where an arm comes to rest with an "
                "object between the fingers (--no-auto-grip)"
            )
    _log_warnings()
    with ExitStack() as stack:
        bus = Bus()
        joins = wires.reserve(stack, bus)
        loaded = load(cell)
        values = {**gains_as_values(loaded, gains), **dict(parse_value(one) for one in set_)}
        loaded = with_values(loaded, values)
        scene = loaded.scene(seed)
        command = ["armcell", "run", script, "--cell", cell, "--mode", mode]
        command += [] if seed is None else ["--seed", str(seed)]
        command += [part for one in set_ for part in ("--set", one)]
        command += [] if gains is None else ["--gains", gains]
        command += [] if time_scale is None else ["--time-scale", f"{time_scale:g}"]
        command += [] if gripping is None else ["--auto-grip" if gripping else "--no-auto-grip"]
        command += wires.words()
        command += ["--without-gate", str(without_gate)] if gate else []
        command += ["--", *arguments] if arguments else []
        by = f"the script {file.name}"
        run = stack.enter_context(
            ExternallyControlledRun(
                loaded, scene, seed, mode, kept, values, by, command, script=file, gate=gate
            )
        )
        observers = run.observers
        if view:
            from armcell.viewer import CellViewer

            viewer = stack.enter_context(CellViewer(scene, title=loaded.name, **at._asdict()))
            observers.append(viewer)
            print_page_address(viewer.page)
        live = loaded.connect(mode, seed, observers, time_scale or 1.0)
        run.begin(live)

        def ended(status: int, session: Session) -> None:
            why = ", interrupted" if session.interrupted else ""
            failure = f"the script ended with status {status}{why}" if status else ""
            run.end(session.served.call, live, error_text(session.served.failure) or failure)

        status, session = run_script(
            file, live, arguments, auto_grip=auto_grip, ros1=_ros1(wires, arguments), ended=ended,
            began=lambda session: wires.open(session, joins), bus=bus, names=wires.names.map_for(loaded),
        )  # fmt: skip
        if session.served.failure is not None:
            raise session.served.failure
        for line in run_failures(run.result) if run.result is not None else ():
            err(line)
            status = status or 1
    return status


def _log_warnings() -> None:
    logging.basicConfig(level=logging.WARNING, format="[%(levelname)s] %(message)s", stream=sys.stderr)
    logging.getLogger("armcell").setLevel(logging.WARNING)


def _ros1(wires: ScriptConnections, arguments: Sequence[str]) -> Ros1Settings | None:
    if not wires.ros1:
        return None
    from armcell.ros.ros1 import from_environment

    return from_environment("armcell", [a for a in arguments if ":=" in a], own_master=wires.own_master)


def _run_elsewhere(
    file: Path, cell: str, arguments: Sequence[str], wires: ScriptConnections, set_: Sequence[str]
) -> int:
    """Run a ROS script from the command line that controls an
    external simulator or robot, and record the run.
    """
    from armcell.cell import load, parse_value, with_values
    from armcell.moveit import run_script
    from armcell.moveit.lint import closes_gripper_itself
    from armcell.ros import Bus

    _log_warnings()
    if not closes_gripper_itself(file):
        err(f"{file.name} commands no gripper: the other end has to close it (armcell sim --auto-grip)")
    bus = Bus()
    with ExitStack() as stack:
        joins = wires.reserve(stack, bus)
        loaded = with_values(load(cell), dict(parse_value(one) for one in set_))
        return run_script(
            file, loaded, arguments, ros1=_ros1(wires, arguments), bus=bus, names=wires.names.map_for(loaded),
            began=lambda session: wires.open(session, joins),
        )[0]  # fmt: skip


def lint(
    scripts: list[Path] = typer.Argument(..., metavar="SCRIPT.py", help="Scripts to read; none is run."),
    as_json: bool = typer.Option(False, "--json", help="Print the findings as JSON."),
) -> int:
    """Lint rospy and moveit_commander scripts. Known traps are reported with their lines and replacements.

    Exit status 1 if there are any.
    """
    from armcell.moveit.lint import lint as findings_of

    found = [(file, finding) for file in scripts for finding in findings_of(file)]
    if as_json:
        rows = [
            {"file": str(f), "line": x.line, "rule": x.rule, "text": x.text, "hint": x.hint} for f, x in found
        ]
        console.print(json.dumps(rows, indent=2), soft_wrap=True, markup=False)
    else:
        for file, finding in found:
            console.print(finding.describe(file), soft_wrap=True, markup=False)
        if not found:
            console.print("no known traps")
    return 1 if found else 0
