"""Many changes of a scene at once, all or nothing: what MoveIt's planning scene diff can say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol

from armcell.core import SE3, InputError, JointState, Octree, Shape, UnknownNameError
from armcell.core.checks import checked
from armcell.scene.objects import CollisionObject, Color, ObjectType
from armcell.scene.scene import WORLD, PlanningScene

OCTOMAP = "<octomap>"
"""Name of the object that holds the octomap, as in MoveIt: to be named where contact with it is allowed."""


class Change(Protocol):
    """One entry of a diff: a small value that makes another scene of a scene."""

    def applied_to(self, scene: PlanningScene) -> PlanningScene: ...


@dataclass(frozen=True, eq=False)
class SceneDiff:
    """Changes in the order in which they are made."""

    changes: tuple[Change, ...] = ()

    @staticmethod
    def of(*changes: Change) -> SceneDiff:
        return SceneDiff(changes)

    def __add__(self, other: SceneDiff) -> SceneDiff:
        return SceneDiff((*self.changes, *other.changes))

    def applied_to(self, scene: PlanningScene) -> PlanningScene:
        """The changed scene; the given one stays as it is, also where a change fails.

        Raises:
            InputError: names the first entry that cannot be made.
        """
        for i, change in enumerate(self.changes):
            try:
                scene = change.applied_to(scene)
            except InputError as error:
                what = type(change).__name__
                name = next((getattr(change, k) for k in ("name", "a", "link") if hasattr(change, k)), None)
                raise InputError(
                    f"{error.reason}; nothing was changed",
                    element=f"diff/{i} {what}" + (f" {name!r}" if isinstance(name, str) else ""),
                    cure=error.cure,
                ) from None
        return scene


# --- objects ---
@dataclass(frozen=True, eq=False)
class AddObject:
    """An object added, or replaced if one of that name is there. Its pose is in `frame`."""

    object: CollisionObject
    frame: str = WORLD

    @property
    def name(self) -> str:
        return self.object.name

    def applied_to(self, scene: PlanningScene) -> PlanningScene:
        T = scene.frame_pose(self.frame) @ self.object.T_world_object
        return scene.with_object(self.object.at(T))


@dataclass(frozen=True, eq=False)
class AppendShapes:
    """Shapes (and subframes) added to an object in the world, in the object's frame."""

    name: str
    shapes: tuple[tuple[Shape, SE3], ...] = ()  # (shape, T_object_shape)
    subframes: Mapping[str, SE3] = field(default_factory=dict)

    def applied_to(self, scene: PlanningScene) -> PlanningScene:
        item = _in_world(scene, self.name)
        subframes = {**item.subframes, **self.subframes}
        return scene.with_object(replace(item, shapes=(*item.shapes, *self.shapes), subframes=subframes))


@dataclass(frozen=True, eq=False)
class MoveObject:
    """An object in the world put elsewhere."""

    name: str
    T_frame_object: SE3
    frame: str = WORLD

    def applied_to(self, scene: PlanningScene) -> PlanningScene:
        return scene.with_object_pose(self.name, scene.frame_pose(self.frame) @ self.T_frame_object)


@dataclass(frozen=True)
class RemoveObject:
    """An object taken away, with what was said about its contacts; detach it first if it is attached."""

    name: str

    def applied_to(self, scene: PlanningScene) -> PlanningScene:
        _in_world(scene, self.name)
        return scene.without_object(self.name)


@dataclass(frozen=True)
class RemoveAllObjects:
    """Everything in the world taken away but the octomap; what is attached stays (as in MoveIt).

    With `attached`, that too: as moveit_commander's PlanningSceneInterface.clear().
    """

    attached: bool = False

    def applied_to(self, scene: PlanningScene) -> PlanningScene:
        if self.attached:
            for name in tuple(scene.attached):
                scene = scene.with_detached(name)
        for name in tuple(scene.objects):
            if name != OCTOMAP:
                scene = scene.without_object(name)
        return scene


@dataclass(frozen=True)
@checked()
class SetColor:
    """r, g, b, a of 0 to 1, of an object in the world or attached."""

    name: str
    color: Color

    def applied_to(self, scene: PlanningScene) -> PlanningScene:
        return _with_property(scene, self.name, color=self.color)


@dataclass(frozen=True)
class SetType:
    name: str
    type: ObjectType

    def applied_to(self, scene: PlanningScene) -> PlanningScene:
        return _with_property(scene, self.name, type=self.type)


# --- holding ---
@dataclass(frozen=True, eq=False)
class AttachObject:
    """An object of the world fixed to a link; or `object`, which is new and placed in that link's frame."""

    name: str
    link: str
    touch_links: tuple[str, ...] = ()
    object: CollisionObject | None = None

    def applied_to(self, scene: PlanningScene) -> PlanningScene:
        if self.object is not None:
            scene = AddObject(replace(self.object, name=self.name), self.link).applied_to(scene)
        return scene.with_attached(self.name, self.link, self.touch_links)


@dataclass(frozen=True)
class DetachObject:
    """An attached object put back into the world where it is, or taken away altogether."""

    name: str
    remove: bool = False

    def applied_to(self, scene: PlanningScene) -> PlanningScene:
        scene = scene.with_detached(self.name)
        return scene.without_object(self.name) if self.remove else scene


# --- what may touch, how near ---
@dataclass(frozen=True)
class Allow:
    """Contact of two bodies allowed or forbidden."""

    a: str
    b: str
    allow: bool = True

    def applied_to(self, scene: PlanningScene) -> PlanningScene:
        return scene.with_allowed(self.a, self.b, self.allow)


@dataclass(frozen=True)
class AllowByDefault:
    """Contact of a body with whatever no pair speaks of; None forgets what was said."""

    name: str
    allow: bool | None = True

    def applied_to(self, scene: PlanningScene) -> PlanningScene:
        return scene.with_default_allowed(self.name, self.allow)


@dataclass(frozen=True)
@checked()
class SetPadding:
    """Padding of all links, and of some, and factors of size; links that are not named stay as they are."""

    padding: float | None = None  # [m]
    links: Mapping[str, float] = field(default_factory=dict)  # [m]
    scales: Mapping[str, float] = field(default_factory=dict)

    def applied_to(self, scene: PlanningScene) -> PlanningScene:
        links, scales = {**scene.link_padding, **self.links}, {**scene.link_scale, **self.scales}
        return scene.with_padding(self.padding, links, scales)


# --- robot, octomap, frames ---
@dataclass(frozen=True, eq=False)
class SetState:
    """Some or all joints moved."""

    state: JointState

    def applied_to(self, scene: PlanningScene) -> PlanningScene:
        return scene.with_state(self.state)


@dataclass(frozen=True, eq=False)
class SetOctomap:
    """The octomap replaced; None clears it."""

    octree: Octree | None
    T_world_octomap: SE3 = SE3.identity()

    def applied_to(self, scene: PlanningScene) -> PlanningScene:
        return with_octomap(scene, self.octree, self.T_world_octomap)


@dataclass(frozen=True, eq=False)
class SetFixedFrame:
    name: str
    T_parent_frame: SE3
    parent: str = WORLD

    def applied_to(self, scene: PlanningScene) -> PlanningScene:
        return scene.with_fixed_frame(self.name, self.T_parent_frame, self.parent)


def with_octomap(
    scene: PlanningScene, octree: Octree | None, T_world_octomap: SE3 = SE3.identity()
) -> PlanningScene:
    """A scene with its octomap (the object `OCTOMAP`) replaced, or cleared by None.

    What may touch the octomap stays: it is the same one, seen anew.
    """
    if octree is not None:
        return scene.with_object(CollisionObject.single(OCTOMAP, octree, T_world_octomap))
    return replace(scene, objects={k: v for k, v in scene.objects.items() if k != OCTOMAP})


def _in_world(scene: PlanningScene, name: str) -> CollisionObject:
    if name in scene.attached:
        raise InputError(f"object {name!r} is attached to the robot", cure="detach it first")
    if name not in scene.objects:
        raise UnknownNameError("object", name, scene.objects)
    return scene.objects[name]


def _with_property(scene: PlanningScene, name: str, **values) -> PlanningScene:
    if name in scene.attached:
        body = scene.attached[name]
        changed = replace(body, object=replace(body.object, **values))
        return replace(scene, attached={**scene.attached, name: changed})
    return scene.with_object(replace(_in_world(scene, name), **values))
