"""Conversion of an SDF world or model into fixed and movable objects of a planning scene."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from armcell.core import SE3, InputError, Mesh, Plane, Shape
from armcell.scene.mesh_object import check_mesh
from armcell.scene.objects import CollisionObject
from armcell.scene.sdf.elements import (
    Element,
    SkippedElement,
    child,
    children,
    fail,
    flag,
    numbers,
    skipped,
    text_of,
)
from armcell.scene.sdf.includes import ResourceFinder
from armcell.scene.sdf.models import Model, ModelReader, Scope, add_frames, saved_poses
from armcell.scene.sdf.solids import SdfCollision, color_of, mass_of, material_of, solid_of

WORLD = {"model", "include", "frame", "gravity", "state"}
GRAVITY, CLOSE = 9.8, 0.05  # [m/s^2]


@dataclass(frozen=True)
class SdfWorld:
    """Result of `load_sdf`: the objects of an SDF world, and the content that was skipped."""

    name: str
    objects: tuple[CollisionObject, ...]
    skipped: tuple[SkippedElement, ...]  # content without a counterpart, or converted to an approximation


def load_sdf(file: str | Path, folders: Sequence[Path] = (), skip: Collection[str] = ()) -> SdfWorld:
    """Load the objects of an SDF world (`.world`, `.sdf`) or of an SDF file that contains only models.

    Links that fixed joints connect become one object, and so does a static model as a whole. Links at other
    joints become fixed objects at their current pose. Masses, frictions and colors are kept; inertias and
    centers of mass follow from the shapes.

    Args:
        file: a file in SDF 1.4 or later.
        folders: folders that are searched first for model:// URIs; GAZEBO_MODEL_PATH, GZ_SIM_RESOURCE_PATH
            and the folders around the file follow.
        skip: names of models to leave out; for an <include>, also the name of the included model.
    Raises:
        InputError: the file is not SDF, a file is missing, a value is not valid, frames form a cycle, there
            are more than `MAX_MODELS` models, or no model has a name in `skip`; the message names file, line
            and element.
    """
    tree = ModelReader(ResourceFinder(folders), skip)
    root = tree.root(Path(file))
    worlds = children(root, "world")
    for other in worlds[1:]:
        tree.notes.append(skipped(other, "only the first world of a file is converted"))
    parent = worlds[0] if worlds else root
    scope = Scope(is_world=True)
    models = list(tree.models_in(parent, scope))
    add_frames(parent, scope)
    if not worlds and not models:
        raise fail(root, "has neither a <world> nor a <model>")
    tree.record_unconverted(parent, WORLD)
    _note_gravity(parent, tree)
    saved = saved_poses(parent)
    objects: list[CollisionObject] = []
    for model in models:
        T = saved.get(model.name)
        T = scope.pose(model.name, model.element) if T is None else T
        _Flat(tree, model, T, saved).add_objects(objects)
    if unused := sorted(tree.skip - tree.used):
        known = ", ".join(m.name for m in models[:20]) or "none"
        raise InputError(f"no model {unused[0]!r} to skip", file=file, hint=f"models: {known}")
    notes = sorted(
        dict.fromkeys(tree.notes), key=lambda note: (note.file != Path(file), str(note.file), note.line)
    )
    return SdfWorld(parent.get("name") or Path(file).stem, tuple(objects), tuple(notes))


def _note_gravity(world: Element, tree: ModelReader) -> None:
    gravity = child(world, "gravity")
    if gravity is None:
        return
    x, y, z = numbers(gravity, gravity.text or "", 3)
    if abs(x) + abs(y) + abs(z + GRAVITY) > CLOSE:
        tree.notes.append(skipped(gravity, f"write physics: {{gravity: [{x:g}, {y:g}, {z:g}]}} in the cell"))


@dataclass
class _Body:
    """A link of a model in an SDF world, with its pose in the world frame."""

    path: str  # "LINK" in the top-level model, "MODEL::LINK" in a nested model
    element: Element
    T_world_link: SE3
    static: bool
    solids: list[SdfCollision] = field(default_factory=list)


class _Flat:
    """A top-level model of an SDF world, flattened with its nested models and converted to scene objects."""

    def __init__(self, tree: ModelReader, model: Model, T_world_model: SE3, saved: dict[str, SE3]):
        self.tree, self.model, self.T_world_model = tree, model, T_world_model
        self.bodies: dict[str, _Body] = {}
        self.joints: list[tuple[Element, str, str]] = []  # (element, parent, child); a path or "world"
        self._flatten(model, T_world_model, "", False)
        for path, body in self.bodies.items():
            body.T_world_link = saved.get(f"{model.name}::{path}", body.T_world_link)
        self._group = {path: path for path in [*self.bodies, "world"]}

    def _flatten(self, model: Model, T_world_model: SE3, prefix: str, static: bool) -> None:
        static = static or model.static
        for name, link in model.links.items():
            body = _Body(prefix + name, link, T_world_model @ model.scope.pose(name, link), static)
            held = flag(link, "kinematic") or not flag(link, "gravity", True)
            if held and not static:
                self.tree.notes.append(
                    skipped(link, "is kinematic or without gravity: it becomes a fixed object")
                )
                body.static = True
            for collision in children(link, "collision"):
                T = model.scope.relative(child(collision, "pose"), name, collision)
                solid, notes = solid_of(collision, T, self.tree.library)
                self.tree.notes += notes
                if solid is not None:
                    body.solids.append(solid)
            self.bodies[body.path] = body
        for inner in model.inner:
            T = T_world_model @ model.scope.pose(inner.name, inner.element)
            self._flatten(inner, T, f"{prefix}{inner.name}::", static)
        for joint in model.joints:
            ends = [self._end(model, joint, tag, prefix) for tag in ("parent", "child")]
            self.joints.append((joint, ends[0], ends[1]))

    def _end(self, model: Model, joint: Element, tag: str, prefix: str) -> str:
        """Return the path of the link at one end of a joint in an SDF world.

        Raises:
            InputError: the link does not exist.
        """
        name, at = text_of(joint, tag), model
        for _ in range(64):
            if name == "world" and tag == "parent":
                return "world"
            if f"{prefix}{name}" in self.bodies:
                return f"{prefix}{name}"
            head, _, rest = name.partition("::")
            inner = next((m for m in at.inner if m.name == head), None)
            if inner is not None:
                prefix, at, name = f"{prefix}{head}::", inner, rest or next(iter(inner.links), "")
                continue
            frame = next((f for f in children(at.element, "frame") if f.get("name") == name), None)
            if frame is None:
                break
            name = frame.get("attached_to") or next(iter(at.links), "")
        raise fail(
            joint, f"unknown {tag} link {text_of(joint, tag)!r}", f"links: {', '.join([*self.bodies][:20])}"
        )

    # --- groups of links that do not move relative to each other ---
    def _root(self, path: str) -> str:
        while self._group[path] != path:
            self._group[path] = path = self._group[self._group[path]]
        return path

    def _join(self, a: str, b: str) -> None:
        self._group[self._root(b)] = self._root(a)

    def _groups(self) -> Iterator[tuple[list[_Body], bool]]:
        """Yield each group of rigidly connected links of a model in an SDF world, and whether the group is
        fixed. Each group with collision geometry becomes one object.
        """
        for path, body in self.bodies.items():
            if body.static:
                self._join("world", path)
        jointed: list[tuple[str, str]] = []
        for joint, parent, kid in self.joints:
            if _is_fixed(joint):
                self._join(*((kid, parent) if kid == "world" else (parent, kid)))
            elif not (self._root(parent) == self._root(kid) == self._root("world")):
                self.tree.notes.append(skipped(joint, "is not converted: its links become fixed objects"))
                jointed.append((parent, kid))
        held = {self._root(path) for pair in jointed for path in pair} | {self._root("world")}
        members: dict[str, list[_Body]] = {}
        for path, body in self.bodies.items():
            members.setdefault(self._root(path), []).append(body)
        yield from ((bodies, root in held) for root, bodies in members.items())

    # --- objects ---
    def add_objects(self, objects: list[CollisionObject]) -> None:
        groups = [(bodies, fixed) for bodies, fixed in self._groups() if self._is_solid(bodies)]
        for bodies, fixed in groups:
            name = self.model.name if len(groups) == 1 else f"{self.model.name}_{bodies[0].path}"
            made = self._object(_free_name(name, objects), bodies, fixed)
            if made is not None:
                objects.append(made)

    def _is_solid(self, bodies: list[_Body]) -> bool:
        for body in bodies:
            if not body.solids and not children(body.element, "collision"):
                self.tree.notes.append(skipped(body.element, "has no collision: nothing touches it"))
        return any(body.solids for body in bodies)

    def _object(self, name: str, bodies: list[_Body], fixed: bool) -> CollisionObject | None:
        first, solids = bodies[0], [solid for body in bodies for solid in body.solids]
        if not fixed and any(isinstance(solid.shape, Plane) for solid in solids):
            self.tree.notes.append(
                skipped(first.element, "has a plane, which cannot move: it becomes a fixed object")
            )
            fixed = True
        T_world_object = first.T_world_link if len(bodies) == 1 else self.T_world_model
        shapes: list[tuple[Shape, SE3]] = []
        for body in bodies:
            alone = len(bodies) == 1
            T_object_link = SE3.identity() if alone else T_world_object.inverse() @ body.T_world_link
            for solid in body.solids:
                if self._fits(body, solid, fixed):
                    shapes.append((solid.shape, T_object_link @ solid.T_link_shape))
        if not shapes:
            return None
        material, differ = material_of(solids)
        if differ:
            self.tree.notes.append(
                skipped(first.element, "has several frictions: the smallest counts for all")
            )
        colors = (color_of(body.element) for body in bodies)
        color = next((c for c in colors if c is not None), CollisionObject.color)
        mass = None if fixed else sum(mass_of(body.element, body.solids) for body in bodies)
        try:
            return CollisionObject(name, tuple(shapes), T_world_object, color, not fixed, mass, material)
        except InputError as error:
            raise fail(first.element, error.reason, error.hint) from None

    def _fits(self, body: _Body, solid: SdfCollision, fixed: bool) -> bool:
        """Return whether the mesh of an object in an SDF world has a plausible size; if not, record
        a note.
        """
        if isinstance(solid.shape, Mesh) and solid.shape.file is not None:
            try:
                check_mesh(solid.shape, not fixed)
            except InputError as error:
                hint = "give the mesh another <scale>" if "scale" in (error.hint or "") else error.hint
                self.tree.notes.append(skipped(body.element, f"{error.file}: {error.reason} ({hint})"))
                return False
        return True


def _is_fixed(joint: Element) -> bool:
    if joint.get("type") == "fixed":
        return True
    limit = child(joint, "axis/limit")
    if joint.get("type") not in ("revolute", "prismatic") or limit is None:
        return False
    ends = [child(limit, tag) for tag in ("lower", "upper")]
    values = [numbers(e, (e.text or "").strip(), 1)[0] for e in ends if e is not None]
    return len(values) == 2 and values[0] == values[1] == 0.0  # early Gazebo had no fixed joint type


def _free_name(name: str, objects: Sequence[CollisionObject]) -> str:
    """Return a name for an object of an SDF world.
    It has no special characters, and no other object has the same name.
    """
    plain = re.sub(r"[^\w.\-]+", "_", name).strip("_") or "object"
    taken, number = {item.name for item in objects}, 2
    found = plain
    while found in taken:
        found, number = f"{plain}_{number}", number + 1
    return found
