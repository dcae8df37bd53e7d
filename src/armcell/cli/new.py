"""`armcell new`: write a first cell for a robot, which runs at once."""

from __future__ import annotations

import os
from pathlib import Path

import typer

from armcell.cli.console import console

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
    """Write a commented cell that runs at once, with a table, an object, a camera and a task."""
    from armcell.cell.starter import starter_cells
    from armcell.core import InputError
    from armcell.model.known_robots import robot_names
    from armcell.model.loader import load_robot
    from armcell.model.options import xacro_args
    from armcell.model.setup import check_folder, write_folder

    check_folder(folder, force)
    model = load_robot(robot)
    if not model.groups:
        raise InputError(
            f"robot {robot!r} has no planning groups",
            hint=f"armcell setup {robot} -o {folder} finds its arm and gripper and writes a cell",
        )
    named = robot in robot_names()
    path = robot if named else os.path.relpath(Path(robot).resolve(), folder.resolve())
    for text in starter_cells(model, path, xacro_args()):
        write_folder(folder, {"cell.yaml": text}, force=True)
        if "pick: cube" not in text or _passes(folder):
            break
    console.print(f"written: {folder}/cell.yaml", markup=False)
    console.print(f"next:    armcell run {folder}   (or: armcell view {folder})", markup=False)
    return 0


def _passes(folder: Path) -> bool:
    from armcell.cli.check import findings

    return all(passed for passed, _, _ in findings(str(folder)))
