"""The models in an SDF file as a tree: links, frames, joints, nested models, and SDF 1.7 pose semantics.

The pose semantics cover `relative_to`, <frame>, nested models and placement frames.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from armcell.core import SE3, InputError
from armcell.model.untrusted_files import parse_xml, read_text
from armcell.scene.sdf.elements import (
    Element,
    SkippedElement,
    child,
    children,
    fail,
    file_of,
    flag,
    name_of,
    pose_of,
    skipped,
    text_of,
)
from armcell.scene.sdf.includes import ResourceFinder

ROOTS = ("", "__model__", "world")
MAX_DEPTH = 256  # longest chain of frames relative to each other
MAX_MODELS = 5000
MAX_NESTING = 24  # depth of nested models, by <model> or <include>
LINK = {
    "pose", "inertial", "collision", "visual", "gravity", "kinematic", "self_collide", "enable_wind",
    "velocity_decay", "must_be_base_link",
}  # fmt: skip
MODEL = {"pose", "static", "link", "model", "include", "joint", "frame", "self_collide", "allow_auto_disable"}
INCLUDE = {"uri", "name", "pose", "static", "placement_frame"}
"""Child elements of SDF links, models and includes that armcell converts or ignores.

All other elements are recorded as skipped.
"""
GROUND_PLANE = """<sdf version="1.6"><model name="ground_plane"><static>true</static><link name="link">
<collision name="collision"><geometry><plane><normal>0 0 1</normal></plane></geometry></collision>
</link></model></sdf>"""
"""Gazebo's standard model `ground_plane`."""


@dataclass
class _Frame:
    element: Element
    parent: str  # the frame that `T_parent_frame` is relative to
    T_parent_frame: SE3


@dataclass
class Scope:
    """Named frames of one SDF model or of the SDF world. Each frame has a pose relative to another frame."""

    frames: dict[str, _Frame] = field(default_factory=dict)
    inner: dict[str, Scope] = field(default_factory=dict)  # nested models
    found: dict[str, SE3] = field(default_factory=dict)
    is_world: bool = False

    def add(
        self, element: Element, name: str, default: str = "", pose: Element | None = None,
        T_pose_frame: SE3 | None = None,
    ) -> None:  # fmt: skip
        """Register a named frame of an SDF model or world. A link, a joint, a nested model or a <frame>
        element defines the frame.

        Args:
            element: the element, for error messages.
            name: name of the frame.
            default: frame that the pose is relative to, if the pose does not name one.
            pose: the <pose> element, if any.
            T_pose_frame: pose of the frame relative to the <pose>, for models with a placement frame.
        Raises:
            InputError: the name is not unique, or the pose is not valid.
        """
        if name in self.frames:
            raise fail(element, f"a second frame of the name {name!r} in one model or world")
        parent = "" if pose is None else pose.get("relative_to") or pose.get("frame") or ""
        T = pose_of(pose)
        self.frames[name] = _Frame(
            element, parent or default, T if T_pose_frame is None else T @ T_pose_frame
        )

    def pose(self, name: str, asked_by: Element, depth: int = 0) -> SE3:
        """Return the pose of an SDF frame, such as `model::link`, relative to the model (or world) that
        contains the frame.

        Args:
            name: name of the frame.
            asked_by: the element that refers to the frame, for error messages.
            depth: current depth of the recursion.
        Raises:
            InputError: the frame is unknown, or its parent frames form a cycle.
        """
        if name in ROOTS and not (name == "world" and not self.is_world):
            return SE3.identity()
        if name in self.found:
            return self.found[name]
        if depth > MAX_DEPTH:
            raise fail(asked_by, f"frame {name!r} hangs on itself")
        frame = self.frames.get(name)
        if frame is None:
            head, _, rest = name.partition("::")
            if rest and head in self.inner:
                return self.pose(head, asked_by, depth + 1) @ self.inner[head].pose(rest, asked_by, depth + 1)
            known = ", ".join(sorted(self.frames)[:20]) or "none"
            raise fail(asked_by, f"unknown frame {name!r}", f"frames here: {known}")
        T = self.pose(frame.parent, frame.element, depth + 1) @ frame.T_parent_frame
        self.found[name] = T
        return T

    def relative(self, pose: Element | None, base: str, asked_by: Element) -> SE3:
        """Resolve a pose that an SDF model states, relative to any of its named frames, into the pose
        relative to the frame `base`.

        The <pose> may itself name another frame with `relative_to`; by default it is relative to `base`.
        """
        named = "" if pose is None else pose.get("relative_to") or pose.get("frame") or ""
        T = pose_of(pose)
        if named in ("", base):
            return T
        return self.pose(base, asked_by).inverse() @ self.pose(named, asked_by) @ T


@dataclass
class Model:
    """One SDF model, with its frames, links, joints and nested models."""

    name: str
    element: Element
    scope: Scope = field(default_factory=Scope)
    links: dict[str, Element] = field(default_factory=dict)
    inner: list[Model] = field(default_factory=list)
    joints: list[Element] = field(default_factory=list)
    static: bool = False


class ModelReader:
    """Reader for nested SDF models. It follows includes and records the elements that it skips."""

    def __init__(self, library: ResourceFinder, skip: Collection[str] = ()):
        self.library, self.skip = library, set(skip)
        self.used: set[str] = set()  # names in `skip` that matched a model
        self.notes: list[SkippedElement] = []
        self._count = 0
        self._roots: dict[Path, Element] = {}

    def root(self, file: Path) -> Element:
        """Let the reader of SDF models read a file, and return its root element <sdf>. Each file is read only
        once.

        Raises:
            InputError: the file is not XML or not SDF.
        """
        if file not in self._roots:
            element = parse_xml(read_text(file), file)
            if element.tag != "sdf":
                hint = (
                    "for a robot's URDF: armcell setup" if element.tag == "robot" else "is this an SDF file?"
                )
                raise fail(element, "root element is not <sdf>", hint)
            self._roots[file] = element
        return self._roots[file]

    def record_unconverted(self, element: Element, known: Collection[str]) -> None:
        """Record the child elements of an SDF model that armcell does not convert."""
        for entry in element:
            if isinstance(entry.tag, str) and entry.tag not in known:
                self.notes.append(skipped(entry, "is not converted"))

    def models_in(self, parent: Element, scope: Scope, depth: int = 0) -> Iterator[Model]:
        """Yield the models in an SDF model or world, including those of its <include>s, and add their frames
        to the named frames.

        Raises:
            InputError: the content is not valid, see `load_sdf`.
        """
        for element in parent:
            if element.tag == "model":
                if not self.skips(element, name_of(element)):
                    yield self._placed(element, element, name_of(element), scope, depth)
            elif element.tag == "include":
                uri = text_of(element, "uri")
                if not self.skips(element, text_of(element, "name", ""), uri.rstrip("/").rpartition("/")[2]):
                    model = self._included(element, uri, scope, depth)
                    if model is not None:
                        yield model

    def skips(self, element: Element, *names: str) -> bool:
        found = self.skip & set(names)
        if found:
            self.used |= found
            self.notes.append(skipped(element, f"left out, as asked ({', '.join(sorted(found))})"))
        return bool(found)

    def _included(self, include: Element, uri: str, scope: Scope, depth: int) -> Model | None:
        """Read the SDF model that an <include> element nests in another model. Return None if it is a light
        or an actor.

        A skipped light or actor is recorded in `notes`.
        """
        root = self._included_root(include, uri)
        if root is None:
            return None
        models = children(root, "model")
        if not models and (children(root, "light") or children(root, "actor")):
            self.notes.append(skipped(include, f"{uri} has no model and is not converted"))
            return None
        if len(models) != 1:
            raise fail(include, f"{file_of(root)} has {len(models)} models, one is needed")
        self.record_unconverted(include, INCLUDE)
        name = text_of(include, "name", name_of(models[0]))
        model = self._placed(models[0], include, name, scope, depth)
        if child(include, "static") is not None:
            model.static = flag(include, "static")
        return model

    def _included_root(self, include: Element, uri: str) -> Element | None:
        """Let the reader of SDF models open the file of a nested model, and return its <sdf> element. Return
        None for Gazebo's sun, which is a light.
        """
        asked_by = child(include, "uri")
        asked_by = include if asked_by is None else asked_by
        try:
            file = self.library.model_file(uri, file_of(include).parent, asked_by)
        except InputError:
            standard = uri.rstrip("/").rpartition("/")[2].lower().replace(" ", "_")
            if standard == "sun":
                self.notes.append(skipped(include, "the sun is a light and is not converted"))
                return None
            if standard == "ground_plane":  # part of Gazebo, so worlds rarely come with a copy
                return parse_xml(GROUND_PLANE, file_of(include))
            raise
        if file.suffix == ".urdf":
            hint = "leave it out with --skip; armcell setup makes a cell of a robot"
            raise fail(include, f"{file} is a URDF", hint)
        return self.root(file)

    def _placed(self, element: Element, placed_by: Element, name: str, scope: Scope, depth: int) -> Model:
        """Build an SDF model and place it at the pose that the element `placed_by` states: the <include> of
        the model, or else the <model> itself.
        """
        model = self._model(element, name, depth + 1)
        pose = child(placed_by, "pose")
        pose = child(element, "pose") if pose is None else pose
        frame = text_of(placed_by, "placement_frame", "") or element.get("placement_frame", "")
        T = model.scope.pose(frame, element).inverse() if frame else None
        scope.add(placed_by, name, pose=pose, T_pose_frame=T)
        scope.inner[name] = model.scope
        return model

    def _model(self, element: Element, name: str, depth: int) -> Model:
        self._count += 1
        if depth > MAX_NESTING:
            raise fail(
                element, f"models are nested deeper than {MAX_NESTING}", "does a model include itself?"
            )
        if self._count > MAX_MODELS:
            raise fail(element, f"the file has more than {MAX_MODELS} models with those it includes")
        model = Model(name, element, static=flag(element, "static"))
        for link in children(element, "link"):
            if name_of(link) in model.links:
                raise fail(link, "a second link of this name")
            model.links[name_of(link)] = link
            model.scope.add(link, name_of(link), pose=child(link, "pose"))
            self.record_unconverted(link, LINK)
        model.inner = list(self.models_in(element, model.scope, depth))
        for joint in children(element, "joint"):
            model.joints.append(joint)
            model.scope.add(joint, name_of(joint), text_of(joint, "child"), child(joint, "pose"))
        add_frames(element, model.scope)
        self.record_unconverted(element, MODEL)
        return model


def add_frames(parent: Element, scope: Scope) -> None:
    """Add the <frame> elements of an SDF model (or world) to its named frames."""
    for frame in children(parent, "frame"):
        scope.add(frame, name_of(frame), frame.get("attached_to", ""), child(frame, "pose"))


def saved_poses(world: Element) -> dict[str, SE3]:
    """Return the world poses of SDF models that Gazebo Classic saved in a <state> of the world. The keys are
    the names of models (MODEL) and of links (MODEL::LINK).
    """
    poses: dict[str, SE3] = {}
    for state in children(world, "state")[:1]:
        for model in children(state, "model"):
            if child(model, "pose") is not None:
                poses[name_of(model)] = pose_of(child(model, "pose"))
            for link in children(model, "link"):
                if child(link, "pose") is not None:
                    poses[f"{name_of(model)}::{name_of(link)}"] = pose_of(child(link, "pose"))
    return poses
