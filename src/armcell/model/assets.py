"""Mesh files of robot descriptions: resolve `package://` URIs, load meshes and colors."""

from __future__ import annotations

import hashlib
import logging
import os
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell._array_store import key_of, recall_or_compute
from armcell.core import InputError, Mesh
from armcell.model.command_line_options import package_folder
from armcell.model.untrusted_files import read_text

if TYPE_CHECKING:
    import trimesh

    from armcell.model.robot import Visual

logger = logging.getLogger(__name__)

EXTRAS = {"example-robot-data": "robots"}
"""Extras of armcell that install packages of robot descriptions, by package."""
MAX_MESH_BYTES = 100_000_000
MAX_PACKAGE_BYTES = 1_000_000  # size limit of a package.xml
WORKSPACE_LEVELS = 3  # folders above a robot's package that can be the workspace with the other repositories
BELOW_WORKSPACE = 3  # depth of a package in a workspace: repository/group/package
BELOW_SEARCHED = 5  # depth of a package below an entry of ROS_PACKAGE_PATH
MAX_FOLDERS = 5000  # folders searched for packages below one folder
MESH_SUFFIXES = {".stl", ".obj", ".dae", ".glb", ".gltf", ".ply", ".off"}
ONE_FILE = {".stl", ".obj", ".dae", ".glb", ".ply", ".off"}
"""Mesh formats that store all triangles in one file, so its content can be a cache key."""
HEAD_BYTES = 100_000  # start of a COLLADA file, which contains the unit
_UNIT = re.compile(rb"""<unit\b[^>]*\bmeter=["']([0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?)["']""")


def installed_share() -> list[Path]:
    """Return the folders in which pip has installed robot descriptions and meshes.

    `example-robot-data`, for example, installs its files into `cmeel.prefix/share` of a `sys.path` entry.
    """
    found = [Path(entry) / "cmeel.prefix" / "share" for entry in sys.path if entry]
    return [share for share in found if os.path.isdir(share)]


PACKAGE_FILE = "package.xml"
_PACKAGE_NAME = re.compile(r"<name>\s*([\w.-]+)\s*</name>")


@dataclass(frozen=True)
class FoundPackage:
    """ROS package with meshes or other robot assets that was found on disk.

    Attributes:
        folder: folder where the search found the package.
        roots: folders with symlinks resolved that contain the package's files. colcon's `--symlink-install`
            adds the source package to the installed one.
    """

    folder: Path
    roots: tuple[Path, ...]


def extra_hint(package: str) -> str:
    """Return the pip command that installs a package of robot assets (descriptions and meshes) with one of
    armcell's extras.
    """
    return f"pip install 'armcell[{EXTRAS[package]}]'"


def search_folders() -> list[Path]:
    """Return the folders to search for robot assets:
    those in ROS_PACKAGE_PATH and AMENT_PREFIX_PATH, and pip's folders.
    """
    named = [
        Path(entry)
        for variable in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH")
        for entry in os.environ.get(variable, "").split(os.pathsep)
        if entry
    ]
    return [*named, *installed_share()]


def package_above(path: Path) -> Path | None:
    """Return the ROS package folder that contains the robot asset at `path`, or None. A `package://` URI can
    refer to this folder.
    """
    return next((folder for folder in path.parents if os.path.isfile(folder / PACKAGE_FILE)), None)


def find_package(package: str, base: Path) -> FoundPackage:
    """Find the ROS package with robot assets that a `package://` URI names: near `base`, in the search path,
    or in pip's folders.

    The search starts with the folders above and beside `base`. There, only a folder with a package.xml counts
    as a package; otherwise a file below /home/me could claim /home as its package.

    Raises:
        InputError: the package does not exist.
    """
    for folder, searched in _package_folders(package, base):
        file = folder / PACKAGE_FILE
        if not os.path.isdir(folder) or not (searched or os.path.isfile(file)):
            continue
        roots = [folder.resolve()]
        if searched and os.path.isfile(file):  # colcon --symlink-install links files to their source package
            roots.append(file.resolve().parent)
        return FoundPackage(folder, tuple(dict.fromkeys(roots)))
    if package in EXTRAS:
        raise InputError(f"package {package!r} is not installed", hint=extra_hint(package))
    raise InputError(
        f"package {package!r} not found above {base}, in ROS_PACKAGE_PATH, AMENT_PREFIX_PATH or among the "
        "installed packages",
        hint=f"pass its folder with --package {package}=FOLDER, put it (with its package.xml) beside the "
        "robot's package, or add its parent folder to ROS_PACKAGE_PATH",
    )


def _package_folders(package: str, base: Path) -> Iterator[tuple[Path, bool]]:
    """Yield folders in which to look for the assets of a `package://` URI, in search order: above the robot
    file, in the ROS search path, then in the workspace. The folder of `--package` comes first.

    Each folder comes with a flag: whether it is from the ROS search path or from pip's folders.
    """
    if package in ("", ".", "..") or "/" in package or "\0" in package:
        return
    if (named := package_folder(package)) is not None:
        yield named, True
    above = [base, *base.parents]
    yield from ((folder, False) for folder in above if _package_name(folder) == package)
    yield from ((folder / package, False) for folder in above)
    yield from ((folder, False) for folder in above if folder.name == package)
    for folder in search_folders():
        yield from ((folder / package, True), (folder / "share" / package, True))
        if folder.name == package:
            yield folder, True
    for folder in _ros_package_path():  # rospack searches below each entry, too
        yield from ((found, True) for found in _packages_below(folder, BELOW_SEARCHED).get(package, ()))
    for folder in _workspaces(base):
        yield from ((found, False) for found in _packages_below(folder, BELOW_WORKSPACE).get(package, ()))


def _ros_package_path() -> list[Path]:
    return [Path(entry) for entry in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if entry]


def _workspaces(base: Path) -> Iterator[Path]:
    """Yield the workspace folders around a robot's ROS package. The search for the robot's assets looks there
    for the other packages on which this package depends.

    They are the folders above the package, up to the folder `src` of a colcon or catkin workspace.
    """
    here = base / "file"
    own = package_above(here)
    if own is None:
        return
    for folder in list(own.resolve().parents)[:WORKSPACE_LEVELS]:
        if folder in (Path.home(), Path(folder.anchor)):
            return
        yield folder
        if folder.name == "src":
            return


def _packages_below(folder: Path, depth: int) -> dict[str, list[Path]]:
    """Find the ROS packages below a folder, like rospack, to search them for robot assets. Return the
    packages' folders by the names in their package.xml.
    """
    try:
        return _crawled(folder, depth, folder.stat().st_mtime_ns)
    except OSError:
        return {}


@lru_cache(maxsize=32)
def _crawled(folder: Path, depth: int, changed: int) -> dict[str, list[Path]]:
    found: dict[str, list[Path]] = {}
    level, seen = [folder], 0
    for _ in range(depth + 1):
        below: list[Path] = []
        for each in level:
            if (name := _package_name(each)) is not None:
                found.setdefault(name, []).append(each)
                continue
            try:
                below += sorted(e for e in each.iterdir() if not e.name.startswith(".") and os.path.isdir(e))
            except OSError:
                continue
        seen += len(below)
        if seen > MAX_FOLDERS:
            break
        level = below
    return found


def _package_name(folder: Path) -> str | None:
    try:
        found = _PACKAGE_NAME.search(read_text(folder / PACKAGE_FILE, MAX_PACKAGE_BYTES))
    except (InputError, OSError):
        return None
    return found[1] if found else None


def find_file(uri: str) -> Path:
    """Return the path of an existing robot asset, which is given as a `package://` URI or a path.

    Relative paths start from the current folder.

    Raises:
        InputError: the file does not exist; the message lists the searched places.
    """
    return resolve_uri(uri, Path.cwd())


def resolve_uri(uri: str, base: Path) -> Path:
    """Return the existing file to which the `package://` URI of a mesh or another robot asset refers.

    The function searches for `package://pkg/rest` in the packages above and beside `base`, in
    ROS_PACKAGE_PATH and AMENT_PREFIX_PATH, and among the robot descriptions installed by pip. Other URIs are
    relative to `base`.

    Args:
        uri: the URI as written in the file.
        base: folder of the file that contains the URI.
    Raises:
        InputError: the file does not exist; the message lists the searched places.
    """
    if uri.startswith("package://"):
        package, _, rest = uri[len("package://") :].lstrip("/").partition("/")  # some files: package:///
        incomplete: Path | None = None  # package without the file
        for folder, searched in _package_folders(package, base):
            path = folder / rest
            # os.path.isfile returns False for invalid file names, where Path.is_file raises
            if rest and os.path.isfile(path):
                return path
            if incomplete is None and os.path.isdir(folder) and (searched or _package_name(folder)):
                incomplete = folder
        if incomplete is not None:
            raise InputError(
                f"{uri} not found: package {package!r} is {incomplete}, but has no file {rest!r}",
                hint=f"check the path, get the complete package, or pass --package {package}=FOLDER",
            )
        if package in EXTRAS:
            raise InputError(f"{uri} not found: the package is not installed", hint=extra_hint(package))
        raise InputError(
            f"{uri} not found above {base}, in ROS_PACKAGE_PATH, AMENT_PREFIX_PATH or among the installed "
            "packages",
            hint=f"pass the folder with --package {package}=FOLDER, put package {package!r} beside the URDF, "
            "or add its parent folder to ROS_PACKAGE_PATH",
        )
    if "://" in uri and not uri.startswith("file://"):
        raise InputError(f"{uri}: only package:// and file:// URIs are read", hint="use a local file")
    path = Path(uri.removeprefix("file://"))
    path = path if path.is_absolute() else base / path
    if not os.path.isfile(path):
        raise InputError(f"mesh file {path} not found", hint="check the path")
    return path


def _checked(path: Path) -> Path:
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise InputError(
            f"mesh format {path.suffix!r} is not read", file=path, hint="use STL, OBJ, DAE, PLY or GLB"
        )
    if not os.path.isfile(path):
        raise InputError("mesh file not found", file=path)
    if path.stat().st_size > MAX_MESH_BYTES:
        raise InputError(f"mesh is larger than {MAX_MESH_BYTES} bytes", file=path)
    return path


def _scale_to_meters(path: Path, scale: tuple[float, float, float]) -> tuple[float, float, float]:
    """Convert the scale (3,) of a mesh asset to meters: multiply it by the length unit [m] that a COLLADA
    file declares, as RViz and Gazebo do.

    Other formats have no unit: their numbers are meters.
    """
    if path.suffix.lower() != ".dae":
        return scale
    with path.open("rb") as stream:
        found = _UNIT.search(stream.read(HEAD_BYTES))
    unit = float(found[1]) if found else 1.0
    if not 0 < unit < np.inf:
        raise InputError(f"the file's unit is {unit:g} m", file=path, hint='<unit meter="1"/> means meters')
    return (scale[0] * unit, scale[1] * unit, scale[2] * unit)


@lru_cache(maxsize=256)
def load_mesh(path: Path, scale: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> Mesh:
    """Load the mesh file of a robot asset as one triangle mesh [m]. Duplicate vertices are merged.

    Args:
        path: mesh file (STL, OBJ, DAE, GLB, GLTF, PLY or OFF).
        scale: factors along x, y and z; the unit of a DAE file also applies.
    Raises:
        InputError: the file is not readable as a mesh, has no triangles, or has a non-finite vertex or a
            bad unit.
    """
    scale = _scale_to_meters(_checked(path), scale)
    if path.suffix.lower() not in ONE_FILE:
        return Mesh(*_read_mesh(path, scale), path)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    key = key_of(version("trimesh"), path.suffix.lower(), repr(scale), digest)
    stored = recall_or_compute(
        "meshes", key, lambda: dict(zip(("vertices", "faces"), _read_mesh(path, scale), strict=True))
    )
    return Mesh(stored["vertices"], stored["faces"], path)


def _read_mesh(
    path: Path, scale: tuple[float, float, float]
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Read the vertices (v, 3) [m] and faces (f, 3) from the mesh file of a robot asset."""
    import trimesh  # imported late, here and below: the import takes 0.5 s, which only new meshes need

    try:
        loaded = trimesh.load(path, force="mesh", process=False)
        vertices = np.asarray(loaded.vertices, dtype=float)  # pyright: ignore[reportAttributeAccessIssue]
        faces = np.asarray(loaded.faces)  # pyright: ignore[reportAttributeAccessIssue]
    except InputError:
        raise
    except Exception as error:  # each mesh library raises different errors; all mean a bad file
        raise InputError(f"cannot be read as a mesh: {error}", file=path) from None
    if len(faces) == 0:
        raise InputError("mesh has no triangles", file=path)
    merged = trimesh.Trimesh(*_sound(vertices, faces, scale, path), process=False)
    merged.merge_vertices(merge_tex=True, merge_norm=True)
    return np.asarray(merged.vertices), merged.faces.astype(np.int32)


def _sound(
    vertices: ArrayLike, faces: ArrayLike, scale: tuple[float, float, float], path: Path
) -> tuple[np.ndarray, np.ndarray]:
    """Check the arrays that were read from the mesh file of a robot asset. Return the scaled vertices (v, 3)
    [m] and the faces (f, 3).

    The mesh libraries do not check the arrays that they read.

    Raises:
        InputError: an array has the wrong shape, a vertex is not finite, or a face refers to a missing
            vertex.
    """
    v, f = np.asarray(vertices, dtype=float), np.asarray(faces)
    if v.ndim != 2 or v.shape[1] != 3 or f.ndim != 2 or f.shape[1] != 3 or f.dtype.kind not in "iu":
        raise InputError(
            f"mesh has vertices of shape {v.shape} and faces of shape {f.shape}, it needs (v, 3) and (f, 3)",
            file=path, hint="a vertex has x, y and z, a face three vertices or more",
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
    """Load the visual mesh asset of a robot as meshes [m]: one for each material, with its RGBA color (0..1).

    Raises:
        InputError: the file is not readable as a mesh or has no triangles.
    """
    scale = _scale_to_meters(_checked(path), scale)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read as a mesh: {error}", file=path) from None
    if path.suffix.lower() not in ONE_FILE or b"mtllib" in content:  # an OBJ's colors are in another file
        return _read_visual_parts(path, scale)
    digest = hashlib.sha256(content).hexdigest()
    key = key_of("visual", version("trimesh"), path.suffix.lower(), repr(scale), digest)

    def read() -> dict[str, NDArray]:
        parts = _read_visual_parts(path, scale)
        return {
            "vertices": np.concatenate([mesh.vertices for mesh, _ in parts]),
            "faces": np.concatenate([mesh.faces for mesh, _ in parts]),
            "ends": np.cumsum([(len(mesh.vertices), len(mesh.faces)) for mesh, _ in parts], axis=0),
            "colors": np.array([color for _, color in parts]),
        }

    stored = recall_or_compute("meshes", key, read)
    vertices, faces = (
        np.split(stored[name], stored["ends"][:-1, i]) for i, name in enumerate(("vertices", "faces"))
    )
    colors = [(r, g, b, a) for r, g, b, a in stored["colors"].tolist()]
    return tuple((Mesh(v, f, path), color) for v, f, color in zip(vertices, faces, colors, strict=True))


def visual_parts(visual: Visual) -> tuple[tuple[Mesh, Color], ...]:
    """Load the mesh assets of a link's visual element [m, visual frame], with their RGBA colors.

    A mesh file that cannot be read is logged and yields no meshes: an image without one link is better than
    no run.
    """
    if visual.file is None:
        return ()
    try:
        parts = load_visual_parts(visual.file, visual.scale)
    except InputError as error:
        logger.warning("visual mesh is not drawn: %s", error)
        return ()
    return parts if visual.color is None else tuple((mesh, visual.color) for mesh, _ in parts)


def _read_visual_parts(path: Path, scale: tuple[float, float, float]) -> tuple[tuple[Mesh, Color], ...]:
    """Read a visual mesh asset of a robot as meshes [m], one for each material, with its RGBA color."""
    import trimesh

    try:
        loaded: Any = trimesh.load(path, process=False)
        parts = loaded.dump() if isinstance(loaded, trimesh.Scene) else [loaded]
        by_color: dict[Color, list[trimesh.Trimesh]] = {}
        for part in parts:
            if isinstance(part, trimesh.Trimesh) and len(part.faces):
                by_color.setdefault(_own_color(part), []).append(part)
        found = tuple((_merged(some, scale, path), color) for color, some in by_color.items())
    except InputError:
        raise
    except Exception as error:  # each mesh library raises different errors; all mean a bad file
        raise InputError(f"cannot be read as a mesh: {error}", file=path) from None
    if not found:
        raise InputError("mesh has no triangles", file=path)
    return found


def _own_color(part: trimesh.Trimesh) -> Color:
    """Return the RGBA color that a mesh asset of a robot defines: the color of the material, or else the mean
    color of the faces.
    """
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
    whole.merge_vertices(merge_tex=True, merge_norm=True)  # files repeat a vertex for each normal
    whole.update_faces(whole.nondegenerate_faces())
    whole.remove_unreferenced_vertices()
    return Mesh(whole.vertices, whole.faces.astype(np.int32), path)
