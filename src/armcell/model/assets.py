"""Finding and loading meshes: `package://` URIs, files, scale, colours."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from armcell.core import InputError, Mesh
from armcell.model.files import read_text

if TYPE_CHECKING:
    import trimesh

MAX_MESH_BYTES = 100_000_000
MAX_PACKAGE_BYTES = 1_000_000  # of a package.xml
MESH_SUFFIXES = {".stl", ".obj", ".dae", ".glb", ".gltf", ".ply", ".off"}


def installed_share() -> list[Path]:
    """Share folders of robot descriptions installed by pip (`example-robot-data` lives in cmeel.prefix)."""
    found = [Path(entry) / "cmeel.prefix" / "share" for entry in sys.path if entry]
    return [share for share in found if share.is_dir()]


PACKAGE_FILE = "package.xml"
_PACKAGE_NAME = re.compile(r"<name>\s*([\w.-]+)\s*</name>")


@dataclass(frozen=True)
class FoundPackage:
    """A ROS package: its folder, and the real folders that its files are in."""

    folder: Path
    roots: tuple[Path, ...]


def search_folders() -> list[Path]:
    """Folders whose packages the user named or installed: ROS_PACKAGE_PATH, AMENT_PREFIX_PATH, pip's."""
    named = [
        Path(entry)
        for variable in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH")
        for entry in os.environ.get(variable, "").split(os.pathsep)
        if entry
    ]
    return [*named, *installed_share()]


def package_above(path: Path) -> Path | None:
    """The folder of the package that a file is in: the nearest above it with a package.xml, or None."""
    return next((folder for folder in path.parents if (folder / PACKAGE_FILE).is_file()), None)


def find_package(package: str, base: Path) -> FoundPackage:
    """A ROS package by name: above or beside `base`, in the user's search path, among the installed ones.

    Around `base` only a folder with a package.xml counts as a package, or else every folder of the machine
    would: a file below /home/me could call /home its package.

    Raises:
        InputError: there is none.
    """
    for folder, searched in _package_folders(package, base):
        file = folder / PACKAGE_FILE
        if not folder.is_dir() or not (searched or file.is_file()):
            continue
        roots = [folder.resolve()]
        if searched and file.is_file():  # colcon --symlink-install links each file to the source package
            roots.append(file.resolve().parent)
        return FoundPackage(folder, tuple(dict.fromkeys(roots)))
    raise InputError(
        f"package {package!r} not found above {base}, in ROS_PACKAGE_PATH or among the installed packages",
        cure=f"put package {package!r} (with its package.xml) beside the robot's package, or add its parent "
        "folder to ROS_PACKAGE_PATH",
    )


def _package_folders(package: str, base: Path) -> Iterator[tuple[Path, bool]]:
    """Folders that may be the package, and whether each is from the user's search path; nearest first."""
    if package in ("", ".", "..") or "/" in package or "\0" in package:
        return
    above = [base, *base.parents]
    yield from ((folder, False) for folder in above if _package_name(folder) == package)
    yield from ((folder / package, False) for folder in above)
    yield from ((folder, False) for folder in above if folder.name == package)
    for folder in search_folders():
        yield from ((folder / package, True), (folder / "share" / package, True))
        if folder.name == package:
            yield folder, True


def _package_name(folder: Path) -> str | None:
    try:
        found = _PACKAGE_NAME.search(read_text(folder / PACKAGE_FILE, MAX_PACKAGE_BYTES))
    except (InputError, OSError):
        return None
    return found[1] if found else None


def find_file(uri: str) -> Path:
    """A file by `package://` URI or path, from the current folder.

    Raises:
        InputError: no such file; lists where it was looked for.
    """
    return resolve_uri(uri, Path.cwd())


def resolve_uri(uri: str, base: Path) -> Path:
    """The file a URDF's mesh URI means.

    `package://pkg/rest` is looked for in the packages above and beside `base`, in ROS_PACKAGE_PATH and
    AMENT_PREFIX_PATH, and among the descriptions installed by pip. Other URIs are relative to `base`.

    Args:
        uri: as written in the file.
        base: folder of the file that says it.
    Raises:
        InputError: no such file; lists where it was looked for.
    """
    if uri.startswith("package://"):
        package, _, rest = uri[len("package://") :].lstrip("/").partition("/")  # some write package:///
        for folder, _ in _package_folders(package, base):
            path = folder / rest
            # unlike Path.is_file, os.path.isfile does not raise for names that no file can have
            if rest and os.path.isfile(path):
                return path
        raise InputError(
            f"{uri} not found above {base}, in ROS_PACKAGE_PATH or among the installed packages",
            cure=f"put package {package!r} beside the URDF or add its parent folder to ROS_PACKAGE_PATH",
        )
    if "://" in uri and not uri.startswith("file://"):
        raise InputError(f"{uri}: only package:// and file:// URIs are read", cure="use a local file")
    path = Path(uri.removeprefix("file://"))
    path = path if path.is_absolute() else base / path
    if not os.path.isfile(path):
        raise InputError(f"mesh file {path} not found", cure="check the path")
    return path


def _checked(path: Path) -> Path:
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise InputError(
            f"mesh format {path.suffix!r} is not read", file=path, cure="use STL, OBJ, DAE, PLY or GLB"
        )
    if path.stat().st_size > MAX_MESH_BYTES:
        raise InputError(f"mesh is larger than {MAX_MESH_BYTES} bytes", file=path)
    return path


@lru_cache(maxsize=256)
def load_mesh(path: Path, scale: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> Mesh:
    """A mesh file as one triangle mesh [m].

    Raises:
        InputError: unreadable, empty or not finite.
    """
    import trimesh  # here and below: it takes half a second, which a program without meshes need not wait

    try:
        loaded = trimesh.load(_checked(path), force="mesh", process=False)
        vertices = np.asarray(loaded.vertices, dtype=float)  # pyright: ignore[reportAttributeAccessIssue]
        faces = np.asarray(loaded.faces)  # pyright: ignore[reportAttributeAccessIssue]
    except InputError:
        raise
    except Exception as error:  # every mesh library has errors of its own; the file is what is wrong
        raise InputError(f"cannot be read as a mesh: {error}", file=path) from None
    if len(faces) == 0:
        raise InputError("mesh has no triangles", file=path)
    merged = trimesh.Trimesh(*_sound(vertices, faces, scale, path), process=False)
    merged.merge_vertices(merge_tex=True, merge_norm=True)
    return Mesh(merged.vertices, merged.faces.astype(np.int32), path)


def _sound(
    vertices: ArrayLike, faces: ArrayLike, scale: tuple[float, float, float], path: Path
) -> tuple[np.ndarray, np.ndarray]:
    """Scaled vertices (v, 3) [m] and faces (f, 3) of what a library has read, which it does not check.

    Raises:
        InputError: of another shape, not finite, or a face of vertices that there are not.
    """
    v, f = np.asarray(vertices, dtype=float), np.asarray(faces)
    if v.ndim != 2 or v.shape[1] != 3 or f.ndim != 2 or f.shape[1] != 3 or f.dtype.kind not in "iu":
        raise InputError(
            f"mesh has vertices of shape {v.shape} and faces of shape {f.shape}, it needs (v, 3) and (f, 3)",
            file=path, cure="a vertex has x, y and z, a face three vertices or more",
        )  # fmt: skip
    if f.size and not 0 <= int(f.min()) <= int(f.max()) < len(v):
        raise InputError(
            f"mesh has a face of vertices {int(f.min())} to {int(f.max())}, but {len(v)} vertices", file=path
        )
    with np.errstate(over="ignore"):
        v = v * np.asarray(scale)
    if not np.isfinite(v).all():
        raise InputError("mesh has a vertex that is not finite", file=path)
    return v, f


Color = tuple[float, float, float, float]
DEFAULT_COLOR: Color = (0.75, 0.75, 0.77, 1.0)


@lru_cache(maxsize=256)
def load_visual_parts(
    path: Path, scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
) -> tuple[tuple[Mesh, Color], ...]:
    """A visual mesh file as one mesh [m] and RGBA colour (0..1) per material, for drawing.

    Raises:
        InputError: unreadable or without triangles.
    """
    import trimesh

    try:
        loaded: Any = trimesh.load(_checked(path), process=False)
        parts = loaded.dump() if isinstance(loaded, trimesh.Scene) else [loaded]
        by_color: dict[Color, list[trimesh.Trimesh]] = {}
        for part in parts:
            if isinstance(part, trimesh.Trimesh) and len(part.faces):
                by_color.setdefault(_own_color(part), []).append(part)
        found = tuple((_merged(some, scale, path), color) for color, some in by_color.items())
    except InputError:
        raise
    except Exception as error:  # every mesh library has errors of its own; the file is what is wrong
        raise InputError(f"cannot be read as a mesh: {error}", file=path) from None
    if not found:
        raise InputError("mesh has no triangles", file=path)
    return found


def _own_color(part: trimesh.Trimesh) -> Color:
    """The one colour of a mesh: its material's, or the mean of its faces'."""
    source = getattr(part.visual, "material", None) or part.visual
    rgba = np.asarray(getattr(source, "main_color", ()), dtype=float)
    if rgba.shape != (4,):
        return DEFAULT_COLOR
    r, g, b, a = (round(float(v) / 255, 3) for v in rgba)
    return (r, g, b, a if a > 0.05 else 1.0)  # some exporters write opaque parts with alpha 0


def _merged(parts: list[trimesh.Trimesh], scale: tuple[float, float, float], path: Path) -> Mesh:
    import trimesh

    vertices, faces, start = [], [], 0
    for part in parts:
        v, f = _sound(part.vertices, part.faces, scale, path)
        vertices.append(v)
        faces.append(f + start)
        start += len(part.vertices)
    whole = trimesh.Trimesh(np.concatenate(vertices), np.concatenate(faces), process=False)
    whole.merge_vertices(merge_tex=True, merge_norm=True)  # files keep a vertex per normal
    whole.update_faces(whole.nondegenerate_faces())
    whole.remove_unreferenced_vertices()
    return Mesh(whole.vertices, whole.faces.astype(np.int32), path)
