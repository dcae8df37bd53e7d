"""`armcell run SCRIPT.py --cell CELL` and `armcell lint SCRIPT.py`."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from armcell.cli.console import console, err, errors
from armcell.cli.gating import gate_of_others
from armcell.cli.listening import tell_listening
from armcell.cli.page import PageAt, tell_page
from armcell.cli.recording import Kept, LedRun, in_words
from armcell.cli.ros1 import check_remap
from armcell.core import InputError

if TYPE_CHECKING:
    from armcell.moveit.session import Session


def run_script_command(
    script: str, cell: str | None, arguments: list[str], seed: int | None, mode: str,
    time_scale: float | None, auto_grip: bool | None, view: bool, at: PageAt, without_gate: str | None,
    kept: Kept, set_: Sequence[str] = (), ros1: bool = False, own_master: bool | None = None,
) -> int:  # fmt: skip
    """Run a rospy / moveit_commander script unchanged against a cell; its exit status.

    With `ros1` both are in a ROS 1 graph; arguments of the form from:=to are remappings then, too.
    """
    check_remap(ros1, None, own_master)
    if cell is None:
        raise InputError(f"no cell for {script}", cure="--cell CELL; `armcell cells` lists the built-in ones")
    file = Path(script)
    if not file.is_file():
        raise InputError("there is no such script", file=file)
    from armcell.cell import complaints, load, parsed, with_values
    from armcell.control import drivers
    from armcell.moveit import run_script
    from armcell.moveit.lint import closes_gripper_itself

    drivers[mode]  # an unknown mode is said before anything is made
    gate = gate_of_others(mode, f"what {file.name} does", without_gate)
    gripping = auto_grip
    if auto_grip is None:
        auto_grip = not closes_gripper_itself(file)
        if auto_grip:
            err(
                f"{file.name} commands no gripper: it closes by itself where an arm comes to rest with an "
                "object between the fingers (--no-auto-grip)"
            )
    logging.basicConfig(level=logging.WARNING, format="[%(levelname)s] %(message)s", stream=sys.stderr)
    logging.getLogger("armcell").setLevel(logging.WARNING)
    with ExitStack() as stack:
        values = dict(parsed(one) for one in set_)
        loaded = with_values(load(cell), values)
        scene = loaded.scene(seed)
        command = ["armcell", "run", script, "--cell", cell, "--mode", mode]
        command += [] if seed is None else ["--seed", str(seed)]
        command += [part for one in set_ for part in ("--set", one)]
        command += [] if time_scale is None else ["--time-scale", f"{time_scale:g}"]
        command += [] if gripping is None else ["--auto-grip" if gripping else "--no-auto-grip"]
        command += ["--ros1"] if ros1 else []
        command += ["--without-gate", str(without_gate)] if gate else []
        command += ["--", *arguments] if arguments else []
        by = f"the script {file.name}"
        run = stack.enter_context(
            LedRun(loaded, scene, seed, mode, kept, values, by, command, script=file, gate=gate)
        )
        observers = run.observers
        if view:
            from armcell.viewer import CellViewer

            viewer = stack.enter_context(CellViewer(scene, title=loaded.name, **at._asdict()))
            observers.append(viewer)
            tell_page(viewer.page)
        live = loaded.connect(mode, seed, observers, time_scale or 1.0)
        joined = None
        if ros1:
            from armcell.ros.ros1 import from_environment

            remap = [a for a in arguments if ":=" in a]
            joined = from_environment("armcell", remap, own_master=own_master)
        run.begin(live)

        def ended(status: int, session: Session) -> None:
            why = ", interrupted" if session.interrupted else ""
            failure = f"the script ended with status {status}{why}" if status else ""
            run.end(session.served.call, live, in_words(session.served.failure) or failure)

        def began(session: Session) -> None:
            if session.graph is not None:
                tell_listening(session.graph.endpoints(), errors)  # standard output is the script's

        status, session = run_script(
            file, live, arguments, auto_grip=auto_grip, ros1=joined, ended=ended, began=began
        )
        if session.served.failure is not None:
            raise session.served.failure
        for line in complaints(run.result) if run.result is not None else ():
            err(line)
            status = status or 1
    return status


def lint(
    scripts: list[Path] = typer.Argument(..., metavar="SCRIPT.py", help="Scripts to read; none is run."),
    as_json: bool = typer.Option(False, "--json", help="Print the findings as JSON."),
) -> int:
    """Known traps in rospy and moveit_commander scripts, with line numbers and what to write instead.

    Exit status 1 where there are any.
    """
    from armcell.moveit.lint import lint as findings_of

    found = [(file, finding) for file in scripts for finding in findings_of(file)]
    if as_json:
        rows = [
            {"file": str(f), "line": x.line, "rule": x.rule, "text": x.text, "cure": x.cure} for f, x in found
        ]
        console.print(json.dumps(rows, indent=2), soft_wrap=True, markup=False)
    else:
        for file, finding in found:
            console.print(finding.describe(file), soft_wrap=True, markup=False)
        if not found:
            console.print("no known traps")
    return 1 if found else 0
