"""Scene diffs: changes that are applied completely or not at all, and differences between two scenes.

The changes cover the content of MoveIt's PlanningScene diff message. Differences between two scenes of
one robot serve records and replanning.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from armcell.core import SE3, InputError, JointState, Octree, PointCloud, Shape, UnknownNameError
from armcell.core.checks import checked
from armcell.scene.objects import CollisionObject, Color, ObjectType
from armcell.scene.scene import WORLD, Change, PlanningScene

OCTOMAP = "<octomap>"
"""Name of the octomap object, as in MoveIt, for example to allow contact with the octomap."""


@dataclass(frozen=True, eq=False)
class SceneDiff:
    """Ordered list of changes to a planning scene (scene diff). Either all of them are applied or none."""

    changes: tuple[Change, ...] = ()

    @staticmethod
    def of(*changes: Change) -> SceneDiff:
        return SceneDiff(changes)

    def __add__(self, other: SceneDiff) -> SceneDiff:
        return SceneDiff((*self.changes, *other.changes))

    def applied_to(self, scene: PlanningScene) -> PlanningScene:
        """Return the scene with all changes of a scene diff applied. The given scene itself does not change.

        Raises:
            InputError: a change cannot be applied; the message names the first such change.
        """
        placed: dict[str, CollisionObject] = {}  # not yet in the scene: one copy of it for all of them
        for i, change in enumerate(self.changes):
            try:
                item = _placed_object(change, placed, scene)
                if item is not None:
                    scene.check_new_name(item.name)
                    placed[item.name] = item
                    continue
                if placed:
                    scene, placed = scene.with_objects(placed.values()), {}
                scene = change.applied_to(scene)
            except InputError as error:
                what = type(change).__name__
                name = next((getattr(change, k) for k in ("name", "a", "link") if hasattr(change, k)), None)
                raise InputError(
                    f"{error.reason}; nothing was changed",
                    element=f"diff/{i} {what}" + (f" {name!r}" if isinstance(name, str) else ""),
                    hint=error.hint,
                ) from None
        return scene.with_objects(placed.values()) if placed else scene


def _placed_object(
    change: Change, placed: Mapping[str, CollisionObject], scene: PlanningScene
) -> CollisionObject | None:
    """Return the world object that a change in a scene diff adds or modifies, or None.

    The change may add the object, move it in the world frame, or set its color or type.

    Returns:
        None for all other changes, and if the change may be invalid.
    """
    if isinstance(change, AddObject) and change.frame == WORLD:
        return change.object
    if not isinstance(change, MoveObject | SetColor | SetType):
        return None
    item = placed.get(change.name) or scene.objects.get(change.name)
    if item is None:
        return None
    if isinstance(change, MoveObject):
        return item.at(change.T_frame_object) if change.frame == WORLD else None
    if isinstance(change, SetColor):
        return item.colored(change.color)
    return item if item.type == change.type else replace(item, type=change.type)


# --- objects ---
@dataclass(frozen=True, eq=False)
class AddObject:
    """A change in a scene diff that adds an object. An existing object with the same name is replaced.

    The object's pose is relative to `frame`.
    """

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
    """A change in a scene diff that adds shapes and subframes to a world object.
    They are given in the object's frame.
    """

    name: str
    shapes: tuple[tuple[Shape, SE3], ...] = ()  # (shape, T_object_shape)
    subframes: Mapping[str, SE3] = field(default_factory=dict)

    def applied_to(self, scene: PlanningScene) -> PlanningScene:
        item = _in_world(scene, self.name)
        subframes = {**item.subframes, **self.subframes}
        return scene.with_object(replace(item, shapes=(*item.shapes, *self.shapes), subframes=subframes))


@dataclass(frozen=True, eq=False)
class ReplacePoints:
    """A change in a scene diff that replaces the points of a point cloud within a box low <= p < high.

    The box has the corners `low` and `high` (3,) [m] in `frame`; an infinite box clears the whole cloud. The
    new `points` (n, 3) [m] are also in `frame`; they may be outside the box.
    """

    name: str
    points: ArrayLike
    low: ArrayLike
    high: ArrayLike
    frame: str = WORLD

    def applied_to(self, scene: PlanningScene) -> PlanningScene:
        item = _in_world(scene, self.name)
        clouds = [i for i, (shape, _) in enumerate(item.shapes) if isinstance(shape, PointCloud)]
        if len(clouds) != 1:
            raise InputError(f"object {self.name!r} has {len(clouds)} point clouds, it must have one")
        cloud, T_object_shape = item.shapes[clouds[0]]
        assert isinstance(cloud, PointCloud)
        T = scene.frame_pose(self.frame).inverse() @ item.T_world_object @ T_object_shape
        points = np.zeros((0, 3)) if np.size(self.points) == 0 else self.points
        cloud = cloud.updated(T.inverse().apply(points), cloud.inside(self.low, self.high, T))
        shapes = [*item.shapes]
        shapes[clouds[0]] = cloud, T_object_shape
        return scene.with_object(replace(item, shapes=tuple(shapes)))


@dataclass(frozen=True, eq=False)
class MoveObject:
    """A change in a scene diff that gives a world object a new pose, relative to `frame`."""

    name: str
    T_frame_object: SE3
    frame: str = WORLD

    def applied_to(self, scene: PlanningScene) -> PlanningScene:
        return scene.with_object_pose(self.name, scene.frame_pose(self.frame) @ self.T_frame_object)


@dataclass(frozen=True)
class RemoveObject:
    """A change in a scene diff that removes a world object and its allowed-collision entries.

    An attached object must be detached first.
    """

    name: str

    def applied_to(self, scene: PlanningScene) -> PlanningScene:
        _in_world(scene, self.name)
        return scene.without_object(self.name)


@dataclass(frozen=True)
class RemoveAllObjects:
    """A change in a scene diff that removes all world objects except the octomap, as in MoveIt.

    Attached objects stay, unless `attached` is True; then the change has the effect of moveit_commander's
    `PlanningSceneInterface.clear()`.
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
    """A change in a scene diff that sets the RGBA color (0 to 1) of a world object or attached object."""

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


# --- attached objects ---
@dataclass(frozen=True, eq=False)
class AttachObject:
    """A change in a scene diff that attaches an object to a link.

    The object is an existing world object, or the new `object`, whose pose is relative to the link.
    """

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
    """A change in a scene diff that detaches an object and leaves it at its current pose in the world.

    With `remove`, the object is removed from the scene instead.
    """

    name: str
    remove: bool = False

    def applied_to(self, scene: PlanningScene) -> PlanningScene:
        scene = scene.with_detached(self.name)
        return scene.without_object(self.name) if self.remove else scene


# --- allowed collisions and padding ---
@dataclass(frozen=True)
class AllowCollision:
    """A change in a scene diff that allows or forbids contact between two bodies."""

    a: str
    b: str
    allow: bool = True

    def applied_to(self, scene: PlanningScene) -> PlanningScene:
        return scene.with_allowed(self.a, self.b, self.allow)


@dataclass(frozen=True)
class AllowCollisionByDefault:
    """A change in a scene diff that sets whether a body may touch all other bodies by default.

    None removes the body's default.
    """

    name: str
    allow: bool | None = True

    def applied_to(self, scene: PlanningScene) -> PlanningScene:
        return scene.with_default_allowed(self.name, self.allow)


@dataclass(frozen=True)
@checked()
class SetPadding:
    """A change in a scene diff that sets the padding [m] and the scale factors of links for collision checks.

    Links that `links` and `scales` do not name keep their individual values.

    Attributes:
        padding: padding of all links [m]; None leaves it unchanged.
        links: padding by link [m].
        scales: scale factor by link.
    """

    padding: float | None = None  # [m]
    links: Mapping[str, float] = field(default_factory=dict)  # [m]
    scales: Mapping[str, float] = field(default_factory=dict)

    def applied_to(self, scene: PlanningScene) -> PlanningScene:
        links, scales = {**scene.link_padding, **self.links}, {**scene.link_scale, **self.scales}
        return scene.with_padding(self.padding, links, scales)


# --- robot, octomap, frames ---
@dataclass(frozen=True, eq=False)
class SetState:
    """A change in a scene diff that sets the positions of some or all robot joints."""

    state: JointState

    def applied_to(self, scene: PlanningScene) -> PlanningScene:
        return scene.with_state(self.state)


@dataclass(frozen=True, eq=False)
class SetOctomap:
    """A change in a scene diff that replaces the octomap, or removes it if `octree` is None."""

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
    """Return the scene with the octomap from a scene diff.
    If `octree` is None, return the scene without an octomap.

    The octomap is the object named `OCTOMAP`.

    Allowed-collision entries of the octomap stay, because a new octomap is an update of the same object.

    Args:
        scene: the scene.
        octree: the new octomap, or None.
        T_world_octomap: pose of the octree.
    """
    if octree is not None:
        return scene.with_object(CollisionObject.single(OCTOMAP, octree, T_world_octomap))
    return replace(scene, objects={k: v for k, v in scene.objects.items() if k != OCTOMAP})


def _in_world(scene: PlanningScene, name: str) -> CollisionObject:
    if name in scene.attached:
        raise InputError(f"object {name!r} is attached to the robot", hint="detach it first")
    if name not in scene.objects:
        raise UnknownNameError("object", name, scene.objects)
    return scene.objects[name]


def _with_property(scene: PlanningScene, name: str, **values) -> PlanningScene:
    if name in scene.attached:
        body = scene.attached[name]
        changed = replace(body, object=replace(body.object, **values))
        return replace(scene, attached={**scene.attached, name: changed})
    return scene.with_object(replace(_in_world(scene, name), **values))


def scene_changes(before: PlanningScene, after: PlanningScene) -> dict[str, Any]:
    """Return what has changed between two scenes: the objects and the allowed collision pairs that differ.

    Joint positions and attached objects are not compared.

    Returns:
        Non-empty entries only: `added` and `changed` {name: CollisionObject}, `moved` {name: T_world_object},
        `removed` [name], and `allowed` [[a, b, allowed]], where `allowed` is None if the pair has no entry
            any more.
    """
    olds, news = before.objects, after.objects
    held = {*before.attached, *after.attached}
    both = [n for n in news if n in olds]
    shapes = {
        n: news[n] for n in both if news[n].shapes is not olds[n].shapes or news[n].color != olds[n].color
    }
    found = {
        "added": {n: o for n, o in news.items() if n not in olds and n not in held},
        "changed": shapes,
        "moved": {
            n: news[n].T_world_object
            for n in both
            if n not in shapes and not news[n].T_world_object.isclose(olds[n].T_world_object, 0.0, 0.0)
        },
        "removed": [n for n in olds if n not in news and n not in held],
        "allowed": [
            [*sorted(pair), after.allowed_pairs.get(pair)]
            for pair in sorted({*before.allowed_pairs, *after.allowed_pairs}, key=sorted)
            if before.allowed_pairs.get(pair) != after.allowed_pairs.get(pair)
        ],
    }
    return {kind: what for kind, what in found.items() if what}


def new_obstacles(before: PlanningScene, now: PlanningScene) -> list[str]:
    """Return the world objects that are new, moved or reshaped in a changed scene.
    They can make replanning necessary.
    """
    found = []
    for name, item in now.objects.items():
        was = before.objects.get(name)
        if was is item:
            continue
        held = before.attached.get(name)
        known = held.object if was is None and held is not None else was
        same = known is not None and known.shapes is item.shapes
        if not (same and (was is None or was.T_world_object.isclose(item.T_world_object))):
            found.append(name)
    return found
