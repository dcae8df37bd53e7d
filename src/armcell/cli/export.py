"""`armcell export`: write a cell as files for other programs."""

from __future__ import annotations

from pathlib import Path

import typer

from armcell.cli.common_options import robot_options
from armcell.cli.console import console, err

app = typer.Typer(
    help="Write a cell for other programs: Unity, or anything that reads URDF.", no_args_is_help=True
)
CELL = typer.Argument(..., help="Built-in cell (see `armcell cells`), folder with cell.yaml, or YAML file.")
UNITY = """
Examples:

  armcell export unity panda_table -o my_unity_project

  armcell export unity panda_pick -o my_unity_project --seed 7

  armcell export unity my_cell/ -o anywhere

FOLDER is a Unity project (2020.3 or later), or any other: then copy its
Assets and Packages into a project. What is written:

  Packages/com.armcell.unity   the C# package: joint states, trajectories,
    gripper, object poses, clock, obstacles; with the classes of moveit_msgs
    and control_msgs, which Unity lacks

  Assets/Armcell/CELL          robot.urdf (flattened), meshes, scene.json

Writing again replaces what was written before; own files are left alone.

Then, in Unity: install the ROS-TCP-Connector (the command prints its URL),
Armcell > Build Cell..., choose scene.json. In a terminal:

  armcell serve CELL --unity --plan-only

Press Play, and ask for a grasp:

  armcell service call /grasp std_srvs/Trigger

Every step, with pictures, is in the package's README.md.
"""
CONNECTOR = (
    "https://github.com/Unity-Technologies/ROS-TCP-Connector.git?path=/com.unity.robotics.ros-tcp-connector"
)


@app.command("unity", epilog=UNITY)
@robot_options
def unity(
    cell: str = CELL,
    output: Path = typer.Option(
        ..., "--output", "-o", metavar="FOLDER", help="A Unity project, or any folder (made when missing)."
    ),
    seed: int | None = typer.Option(
        None, min=0, help="Draw of the randomised values; the cell's nominal ones by default."
    ),
) -> None:
    """Export a cell for Unity: armcell's C# package, the robot with its meshes, and the scene."""
    from armcell.cell import load
    from armcell.ros.unity import export_unity

    done = export_unity(load(cell), output, seed)
    for name in done.left_out:
        err(f"{name} is a cloud of points: Unity gets no collider for it")
    console.print(f"package  {done.package}", markup=False)
    console.print(f"cell     {done.cell}", markup=False)
    console.print(f"Unity needs (Package Manager, Add package from git URL)  {CONNECTOR}", markup=False)
    console.print(f"then     Armcell > Build Cell... > {done.cell.name}/scene.json", markup=False)
    if not done.is_project:
        err(f"{output} is no Unity project: copy its Assets and Packages into one")


@app.command("urdf")
@robot_options
def urdf(
    cell: str = CELL,
    output: Path = typer.Option(
        ..., "--output", "-o", metavar="FOLDER", help="Folder (made when missing) for robot.urdf and meshes/."
    ),
) -> None:
    """Export the robot of a cell as a single flattened URDF, with the meshes next to the file."""
    from armcell.cell import load
    from armcell.core import InputError
    from armcell.ros.unity import write_urdf

    try:
        file = write_urdf(load(cell).model, output)
    except OSError as error:
        raise InputError(f"cannot write there ({error.strerror})", file=error.filename) from None
    console.print(str(file), markup=False)
