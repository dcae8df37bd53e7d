"""`armcell import`: convert a Gazebo world to objects of a cell."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer
from rich.table import Table

from armcell.cli.console import check_writable, console, write_json

EXAMPLES = """
Examples:

  armcell import warehouse.world                               what it has, and what is not converted

  armcell import warehouse.world --robot panda -o my_cell.yaml   a new cell

  armcell import table.sdf --into my_cell --at 0.6,0,0         more objects in a cell that exists

  armcell import cell.sdf -o objects.yaml                      objects only

  GZ_SIM_RESOURCE_PATH=~/models armcell import cell.sdf --skip my_robot --robot . -o cell.yaml

armcell looks for model://NAME in --package, GAZEBO_MODEL_PATH, GZ_SIM_RESOURCE_PATH and beside the file, and
downloads nothing. Leave the robot's own model out with --skip: the cell has its robot.
"""


def import_(
    file: Path = typer.Argument(
        ..., metavar="FILE.world|FILE.sdf", help="An SDF world, or a file of models."
    ),
    output: Path | None = typer.Option(
        None, "--output", "-o", metavar="FILE.yaml", help="Write a new file; meshes go beside it."
    ),
    into: str | None = typer.Option(None, metavar="CELL", help="Add the objects to this cell's file."),
    robot: str | None = typer.Option(
        None,
        metavar="MODEL",
        help="Robot of the new cell: of the library, or a folder or file relative to -o.",
    ),
    package: list[Path] = typer.Option(
        [], "--package", metavar="FOLDER", help="Where model:// is looked for first; may be repeated."
    ),
    skip: list[str] = typer.Option([], "--skip", metavar="NAME", help="Model to leave out; may be repeated."),
    prefix: str = typer.Option("", metavar="TEXT", help="Before every object's name."),
    at: str = typer.Option("0,0,0", metavar="X,Y,Z", help="Where the world's origin is in the cell [m]."),
    rpy_deg: str = typer.Option("0,0,0", metavar="R,P,Y", help="How the world is turned in the cell [deg]."),
    force: bool = typer.Option(False, "--force", help="Replace the file of -o."),
    json_file: Path | None = typer.Option(None, "--json", metavar="FILE", help="Write the list as JSON."),
) -> int:
    """Import a Gazebo world as objects of a cell. Elements that cannot be converted are listed.

    Exit status 0 if the file was read and, with --output or --into, the objects were written.
    """
    import numpy as np

    from armcell.cell.world_import import add_to_cell, import_world, write_imported
    from armcell.cli.setup import parse_numbers
    from armcell.core import SE3

    if output is not None and into is not None:
        raise typer.BadParameter("-o writes a new file and --into adds to a cell: give one of them")
    if robot is not None and output is None:
        raise typer.BadParameter("--robot is for a new cell: it needs -o FILE.yaml")
    for target in (output, json_file):
        if target is not None:
            check_writable(target)
    T = SE3.from_xyz_rpy(parse_numbers("--at", at), np.deg2rad(parse_numbers("--rpy-deg", rpy_deg)))
    world = import_world(file, package, skip, prefix, T)
    console.print(_table(world.objects))
    if world.skipped:
        console.print(f"not converted, or only in part ({len(world.skipped)}):")
        for note in world.skipped:
            console.print(f"  {note}", markup=False, highlight=False, soft_wrap=True)
    if json_file is not None:
        write_json(json_file, _numbers(world))
    if not world.objects:
        console.print("no object: nothing to write")
    elif output is not None:
        write_imported(world.objects, output, robot, force)
        console.print(f"written: {output}", markup=False)
        if robot is not None:
            console.print(f"next:    armcell check {output}", markup=False)
    elif into is not None:
        console.print(f"added to {add_to_cell(world.objects, into)}", markup=False)
        console.print(f"next:    armcell check {into}", markup=False)
    else:
        console.print("nothing written: add -o FILE.yaml or --into CELL", markup=False)
    return 0


def _table(objects: Any) -> Table:
    from armcell.core import shape_name

    table = Table(box=None, pad_edge=False, header_style="bold")
    for title in ("object", "shapes", "at [m]", "mass", "friction"):
        table.add_column(title)
    for item in objects:
        kinds = [shape_name(shape) for shape, _ in item.shapes]
        shapes = ", ".join(f"{kinds.count(k)} {k}" if kinds.count(k) > 1 else k for k in dict.fromkeys(kinds))
        material = item.material
        friction = f"{material.friction:g}"
        friction += f" / {material.dynamic_friction:g}" if material.dynamic_friction is not None else ""
        at = " ".join(f"{v:.3f}" for v in item.T_world_object.translation)
        table.add_row(item.name, shapes, at, f"{item.mass_kg:.3g} kg" if item.movable else "fixed", friction)
    return table


def _numbers(world: Any) -> dict[str, Any]:
    from armcell.core import shape_name

    return {
        "world": world.name,
        "objects": [
            {
                "name": item.name,
                "shapes": [shape_name(shape) for shape, _ in item.shapes],
                "position_m": item.T_world_object.translation.tolist(),
                "quat_xyzw": item.T_world_object.quat_xyzw.tolist(),
                "movable": item.movable,
                "mass_kg": item.mass_kg if item.movable else None,
                "friction": {"static": item.material.friction, "dynamic": item.material.sliding},
            }
            for item in world.objects
        ],
        "skipped": [
            {"file": str(note.file), "line": note.line, "element": note.what, "why": note.why}
            for note in world.skipped
        ],
    }
