"""`armcell new`: write a first cell for a robot, which runs at once."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from armcell.cli.console import console

if TYPE_CHECKING:
    from armcell.model import RobotModel

EXAMPLES = """
Examples:

  armcell new my_cell --robot panda          a table, a cube, a camera and a task; then: armcell run my_cell

  armcell new my_cell --robot my_robot/      a folder from armcell setup, or any robot file
"""


def new(
    folder: Path = typer.Argument(..., metavar="FOLDER", help="Folder to write."),
    robot: str = typer.Option(
        ..., "--robot", metavar="NAME_OR_FILE", help="A robot's name (see armcell robots), folder or file."
    ),
    force: bool = typer.Option(False, "--force", help="Write into a folder that is not empty."),
) -> int:
    """Write a new, commented cell that runs at once, with a table, an object, a camera and a task."""
    from armcell.core import InputError
    from armcell.model.loader import load_robot, robot_names
    from armcell.model.setup import check_folder

    check_folder(folder, force)
    model = load_robot(robot)
    if not model.groups:
        raise InputError(
            f"robot {robot!r} has no planning groups",
            hint=f"armcell setup {robot} -o {folder} finds its arm and gripper and writes a cell",
        )
    if not model.arm_groups:
        hint = "mount a hand on an arm (key 'parts' of robot.yaml), or give an SRDF group a chain"
        raise InputError(f"robot {robot!r} has no arm: no planning group is a chain with a tip", hint=hint)
    named = robot in robot_names()
    path = robot if named else os.path.relpath(Path(robot).resolve(), folder.resolve())
    write_starter(model, path, folder)
    console.print(f"written: {folder}/cell.yaml", markup=False)
    console.print(f"next:    armcell run {folder}   (or: armcell view {folder})", markup=False)
    return 0


def write_starter(model: RobotModel, path: str, folder: Path) -> bool:
    """Write, for `armcell new`, the first starter cell in which a fake arm picks the cube, or else a cell
    that only moves the arm. Return whether the task of the written cell is to pick the cube.

    Args:
        path: how the cell names the robot.
    """
    from armcell.cell.starter import starter_cells
    from armcell.model.command_line_options import xacro_args
    from armcell.model.setup import write_folder

    text = ""
    for text in starter_cells(model, path, xacro_args()):
        write_folder(folder, {"cell.yaml": text}, force=True)
        if "pick: cube" not in text or _passes(folder, model):
            break
    return "pick: cube" in text


def _passes(folder: Path, model: RobotModel) -> bool:
    """Return whether the cell that `armcell new` has written for a robot passes all checks and its task
    succeeds with fake arms, which follow every command exactly.
    """
    from armcell.cell import load, run_task
    from armcell.cli.check import findings

    cell = load(folder, model=model)
    if not all(passed for passed, _, _ in findings(cell)):
        return False
    with cell.connect("fake", seed=0) as live:
        return bool(run_task(cell, live, 0, "fake")["success"])
