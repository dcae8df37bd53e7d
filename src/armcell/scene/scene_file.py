"""Reader and writer of MoveIt's .scene files, which contain a planning scene's objects.

MoveIt's `saveGeometryToStream` and RViz write these files.

The new format has a pose and subframes for each object; in the old format, objects are at the world origin.
The reader detects the format at the first object, as MoveIt's `PlanningScene::loadGeometryFromStream` does. A
color of all zeros means "no color". The files contain no object types, masses or point clouds.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from armcell.core import (
    SE3,
    SO3,
    Format,
    InputError,
    Mesh,
    Plane,
    Shape,
    named_shapes,
    shape_kind,
    shape_name,
)
from armcell.model.untrusted_files import read_text
from armcell.scene.objects import CollisionObject, Color

log = logging.getLogger(__name__)

MAX_PARTS = 1_000_000
"""Maximum number of shapes, vertices or triangles of a file; a larger number is an error."""


def save_scene_file(objects: Iterable[CollisionObject], path: str | Path, name: str = "armcell") -> list[str]:
    """Write scene objects to a .scene file in MoveIt's newer format, with full numeric precision.

    Args:
        objects: the objects.
        path: the file.
        name: name of the scene in the file.
    Returns:
        Names of the objects left out: octomaps and point clouds, which the format does not support.
    Raises:
        InputError: an object contains a capsule (unknown to MoveIt), or a name contains a line break or, for
            a subframe, white space.
    """
    lines, left_out = [name], []
    for item in objects:
        if item.has_cloud:
            left_out.append(item.name)
            continue
        if "\n" in item.name or any(re.search(r"\s", s) for s in item.subframes):
            raise InputError(f"object {item.name!r}: a name with a space or line break cannot be written")
        lines += [f"* {item.name}", *_pose_lines(item.T_world_object), str(len(item.shapes))]
        for shape, T in item.shapes:
            lines += [*_shape_lines(item.name, shape), *_pose_lines(T), _numbers(item.color)]
        lines.append(str(len(item.subframes)))
        for subframe, T in item.subframes.items():
            lines += [subframe, *_pose_lines(T)]
    Path(path).write_text("\n".join([*lines, ".\n"]), encoding="utf-8")
    return left_out


def load_scene_file(path: str | Path) -> tuple[CollisionObject, ...]:
    """Load the objects of a MoveIt .scene file, in the newer or the older format, as fixed world objects.

    Raises:
        InputError: the file is not a valid .scene file; the message contains file, line and reason.
    """
    return _Reader(Path(path)).objects()


def _numbers(values) -> str:
    return " ".join(repr(float(v)) for v in values)


def _pose_lines(T: SE3) -> list[str]:
    return [_numbers(T.translation), _numbers(T.quat_xyzw)]


def _shape_lines(name: str, shape: Shape) -> list[str]:
    kind = shape_kind(shape, Format.SCENE_FILE)
    if kind is not None:
        return [shape_name(shape), _numbers(kind.values(shape))]
    if isinstance(shape, Plane):
        return ["plane", _numbers((0, 0, 1, 0))]
    if isinstance(shape, Mesh):
        rows = [f"{len(shape.vertices)} {len(shape.faces)}", *map(_numbers, shape.vertices)]
        return ["mesh", *rows, *(" ".join(map(str, face)) for face in shape.faces.tolist())]
    raise InputError(
        f"object {name!r}: a {shape_name(shape)} cannot be written to a .scene file",
        hint="build it of cylinder and spheres, or save it as YAML",
    )


class _Reader:
    """Reader of a MoveIt .scene file. It reads one word at a time and keeps track of the line number.

    As in MoveIt's reader, line breaks only matter in object names.
    """

    def __init__(self, path: Path):
        self.path = path
        self.lines = read_text(path, 100_000_000).splitlines()
        if not self.lines or not any(line.strip() for line in self.lines):
            raise InputError("is empty, a .scene file begins with the scene's name", file=path)
        self.row = 1  # index of the next line to read; line 0 is the scene's name
        self.words: list[str] = []

    def fail(self, reason: str) -> InputError:
        return InputError(reason, file=self.path, line=min(self.row, len(self.lines)))

    def word(self, wanted: str) -> str:
        while not self.words:
            if self.row >= len(self.lines):
                raise self.fail(f"ends where {wanted} is wanted: the file is cut off")
            self.words = self.lines[self.row].split()
            self.row += 1
        return self.words.pop(0)

    def number(self, wanted: str) -> float:
        text = self.word(wanted)
        try:
            value = float(text)
        except ValueError:
            raise self.fail(f"{text!r} stands where {wanted} is wanted") from None
        if not np.isfinite(value):
            raise self.fail(f"{wanted} is {text}, it must be finite")
        return value

    def count(self, wanted: str) -> int:
        text = self.word(wanted)
        if not text.isascii() or not text.isdigit() or len(text) > 9 or int(text) > MAX_PARTS:
            raise self.fail(f"{text!r} stands where {wanted} is wanted")
        return int(text)

    def pose(self, of: str) -> SE3:
        xyz = [self.number(f"the position of {of}") for _ in range(3)]
        quat_xyzw = np.array([self.number(f"the quaternion of {of}") for _ in range(4)])
        norm = np.linalg.norm(quat_xyzw)
        if not 0.9 < norm < 1.1:  # tolerant: MoveIt writes six digits and does not normalize
            raise self.fail(f"the quaternion of {of} has norm {norm:.3g}, a rotation needs norm 1")
        return SE3.from_quat_xyzw(xyz, quat_xyzw / norm)

    def objects(self) -> tuple[CollisionObject, ...]:
        found: dict[str, CollisionObject] = {}
        posed = self._has_object_poses()
        while True:
            marker = self.word("'*' (an object) or '.' (the end)")
            if marker == ".":
                return tuple(found.values())
            if marker != "*":
                raise self.fail(f"{marker!r} stands where '*' (an object) or '.' (the end) is wanted")
            name = " ".join(self.words)
            self.words = []
            if not name:
                raise self.fail("an object needs a name after '*'")
            item = self._object(name, posed)
            if item is not None:
                found[name] = item

    def _has_object_poses(self) -> bool:
        for i, line in enumerate(self.lines[1:-1], start=1):
            if line.startswith("*"):
                return len(self.lines[i + 1].split()) > 1
        return False

    def _object(self, name: str, posed: bool) -> CollisionObject | None:
        what = f"object {name!r}"
        T_world_object = self.pose(what) if posed else SE3.identity()
        shapes: list[tuple[Shape, SE3]] = []
        color: Color | None = None
        for i in range(self.count(f"the number of shapes of {what}")):
            shape, T_shape = self._shape(f"shape {i} of {what}")
            shapes.append((shape, self.pose(f"shape {i} of {what}") @ T_shape))
            r, g, b, a = (self.number(f"the color of {what}") for _ in range(4))
            if max(r, g, b, a) > 0:
                color = (r, g, b, a)
        subframes = {}
        for _ in range(self.count(f"the number of subframes of {what}") if posed else 0):
            subframe = self.word("the name of a subframe")
            subframes[subframe] = self.pose(f"subframe {subframe!r} of {what}")
        if not shapes:
            log.warning("%s: %s has no shape and is left out", self.path, what)
            return None
        try:
            item = CollisionObject(name, tuple(shapes), T_world_object, subframes=subframes)
            return item if color is None else replace(item, color=color)
        except InputError as error:
            raise self.fail(error.reason) from None

    def _shape(self, what: str) -> tuple[Shape, SE3]:
        kind, here, sized = self.word(f"the kind of {what}"), SE3.identity(), named_shapes(Format.SCENE_FILE)
        size = lambda n: [self.number(f"the size of {what}") for _ in range(n)]  # noqa: E731
        try:
            if kind in sized:
                return sized[kind].make(*size(len(sized[kind].sizes))), here
            match kind:
                case "plane":
                    return self._plane(size(4))
                case "mesh":
                    v, f = self.count(f"the number of vertices of {what}"), self.count("that of triangles")
                    vertices = [[self.number(f"a vertex of {what}") for _ in range(3)] for _ in range(v)]
                    faces = [[self.count(f"a corner of {what}") for _ in range(3)] for _ in range(f)]
                    return Mesh(np.array(vertices).reshape(-1, 3), np.array(faces).reshape(-1, 3)), here
        except InputError as error:
            raise error if error.file is not None else self.fail(f"{what}: {error.reason}") from None
        raise self.fail(f"{what} is a {kind!r}; known: {', '.join(sized)}, plane, mesh")

    def _plane(self, equation: list[float]) -> tuple[Shape, SE3]:
        """Convert the plane a x + b y + c z + d = 0 in a .scene file to a half-space and its pose."""
        normal, d = np.array(equation[:3]), equation[3]
        length = float(np.linalg.norm(normal))
        if length == 0:
            raise InputError("a plane needs a normal that is not zero")
        return Plane(), SE3(SO3.between((0, 0, 1), normal), -d * normal / length**2)
