"""Export of a cell for Unity: the C# package with message classes, the robot and the scene."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass
from pathlib import Path

from armcell.cell import Cell
from armcell.core import InputError
from armcell.ros.csharp_generator import generate_csharp, write
from armcell.ros.schema import Schema, schema
from armcell.ros.unity.scene import scene_json
from armcell.ros.unity.urdf import file_name, write_urdf

PACKAGE = "com.armcell.unity"
MESSAGES = "Messages"  # folder of the generated classes in the package
SCENE, URDF = "scene.json", "robot.urdf"


@dataclass(frozen=True)
class UnityExport:
    """Result of exporting a cell for Unity: the folders that were written and the objects that were omitted.

    Attributes:
        package: folder of the C# package.
        cell: folder of the cell's robot, meshes and scene.
        left_out: names of objects without colliders in Unity (point clouds and octrees).
    """

    package: Path
    cell: Path
    left_out: tuple[str, ...]
    is_project: bool  # the folder is a Unity project


def package_source() -> Path:
    """Return the folder of the C# package for Unity. In a source checkout, this is a link to `unity/`.

    Raises:
        InputError: the folder contains no package.
    """
    folder = Path(__file__).parent / "package"
    if not (folder / "package.json").is_file():
        raise InputError("is missing, armcell is not installed whole", file=folder, hint="install it again")
    return folder


def export_unity(
    cell: Cell, folder: Path, seed: int | None = None, types: Schema | None = None
) -> UnityExport:
    """Write a Unity package and the assets of a cell into a folder, e.g. a Unity project.

    The folders are `Packages/com.armcell.unity` and `Assets/Armcell/<cell>`. The export replaces the files of
    an earlier export and leaves other files unchanged.

    Raises:
        InputError: a file cannot be written.
    """
    package, target = folder / "Packages" / PACKAGE, folder / "Assets" / "Armcell" / file_name(cell.name)
    try:
        is_project = (folder / "ProjectSettings").is_dir()
        copy_package(package, types)
        target.mkdir(parents=True, exist_ok=True)
        write_urdf(cell.model, target, URDF)
        data, left_out = scene_json(cell, seed, target, URDF)
        (target / SCENE).write_text(json.dumps(data, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    except OSError as error:
        raise InputError(f"cannot write there ({error.strerror})", file=error.filename) from None
    return UnityExport(package, target, tuple(left_out), is_project)


def copy_package(target: Path, types: Schema | None = None) -> None:
    """Copy the C# package for Unity and add generated C# classes of moveit_msgs and control_msgs."""
    shutil.copytree(package_source(), target, dirs_exist_ok=True)
    write(generate_csharp(types or schema()), target / MESSAGES)
