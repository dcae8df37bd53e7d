"""`PlanningScene`: an immutable robot state with objects, allowed collisions, and its extent for viewers.

Allowed collisions have per-body defaults in addition to body pairs.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core import SE3, InputError, JointState, UnknownNameError
from armcell.core.checks import checked, float_array
from armcell.kinematics import kinematic_tree
from armcell.model import RobotModel
from armcell.scene.objects import CLOUDS_STAND, USE_A_SOLID, CollisionObject

Array = NDArray[np.float64]
WORLD = "world"
LARGE = 2.0  # [m] an object that extends farther from its origin counts as surroundings


def explicit_allowed_pairs(scene: PlanningScene) -> Mapping[frozenset[str], bool]:
    """Return the allowed collision pairs of a scene.
    Defaults for single bodies are expanded to pairs of bodies.

    An entry for a pair takes precedence over defaults. If the defaults of two bodies disagree, their contact
    is not allowed, as in MoveIt's AllowedCollisionMatrix.

    Returns:
        Pair of body names -> whether their contact is allowed.
    """
    pairs = dict(scene.allowed_pairs)
    bodies = [*scene.model.links, *scene.objects, *scene.attached]
    for name, allow in scene.allowed_defaults.items():
        for other in bodies:
            if allow and other != name and scene.allowed_defaults.get(other, True):
                pairs.setdefault(frozenset((name, other)), True)
    return pairs


def without_allowed_entries(scene: PlanningScene, name: str) -> PlanningScene:
    """Return the scene without any allowed-collision entries for a given body."""
    return replace(
        scene,
        allowed_pairs={pair: allow for pair, allow in scene.allowed_pairs.items() if name not in pair},
        allowed_defaults={k: allow for k, allow in scene.allowed_defaults.items() if k != name},
    )


class Change(Protocol):
    """One change in a scene diff. `applied_to` returns the changed planning scene."""

    def applied_to(self, scene: PlanningScene) -> PlanningScene: ...


@dataclass(frozen=True, eq=False)
class AttachedBody:
    """Object that is attached to a robot link in a planning scene. It may touch the links in
    `touch_links`.
    """

    object: CollisionObject
    link: str
    T_link_object: SE3
    touch_links: frozenset[str] = frozenset()


@dataclass(frozen=True, eq=False)
@checked()
class PlanningScene:
    """An immutable planning scene: the robot, its state, the objects and the allowed collisions.

    The `with_*()` methods return a changed copy. The world frame is the frame of the robot's root link.
    `positions` (dof,) [rad or m] have the model's joint order.
    """

    model: RobotModel
    positions: Array
    objects: Mapping[str, CollisionObject] = field(default_factory=dict)
    attached: Mapping[str, AttachedBody] = field(default_factory=dict)
    allowed_pairs: Mapping[frozenset[str], bool] = field(default_factory=dict)  # overrides the SRDF's pairs
    allowed_defaults: Mapping[str, bool] = field(default_factory=dict)  # by body, for pairs without an entry
    padding: float = 0.0  # [m] around every link, only for checks against objects
    link_padding: Mapping[str, float] = field(default_factory=dict)
    link_scale: Mapping[str, float] = field(default_factory=dict)
    fixed_frames: Mapping[str, SE3] = field(default_factory=dict)  # T_world_frame by name

    def __post_init__(self) -> None:
        positions = np.array(float_array(self.positions, None, "positions", finite=False))
        positions.setflags(write=False)
        object.__setattr__(self, "positions", positions)

    @staticmethod
    def of(
        model: RobotModel, positions: ArrayLike | None = None, objects: Iterable[CollisionObject] = ()
    ) -> PlanningScene:
        q = model.default_positions() if positions is None else model.check_positions(positions)
        scene = PlanningScene(model, np.array(q))
        for item in objects:
            scene = scene.with_object(item)
        return scene

    # --- state ---
    @cached_property
    def state(self) -> JointState:
        return JointState(self.model.joint_names, self.positions)

    def with_positions(self, positions: ArrayLike) -> PlanningScene:
        """Return the planning scene with the robot at new joint positions (dof,) [rad or m].

        Raises:
            InputError: wrong length, a non-finite value, or a position outside the limits.
        """
        return replace(
            self, positions=np.array(self.model.check_positions(positions, margin=1e-3), dtype=float)
        )

    def with_state(self, state: JointState) -> PlanningScene:
        """Return the planning scene with the positions from a joint state. Joints that the joint state does
        not name keep their positions.

        Mimic joints, as ROS's /joint_states names them, follow their own joints and are ignored here.
        """
        joints = self.model.joints
        names = [n for n in state.joint_names if n not in joints or joints[n].mimic is None]
        if len(names) < len(state.joint_names):
            state = state.reindexed(names)
        return self.with_positions(self.state.updated(state).positions)

    # --- objects ---
    def object(self, name: str) -> CollisionObject:
        """Return a world object or attached object of the planning scene by name, with its current pose.

        Raises:
            UnknownNameError: the scene has no such object.
        """
        if name in self.objects:
            return self.objects[name]
        if name in self.attached:
            return self.attached[name].object.at(self.frame_pose(name))
        raise UnknownNameError("object", name, [*self.objects, *self.attached])

    def with_object(self, item: CollisionObject) -> PlanningScene:
        """Return the planning scene with one more object. An existing object with the same name is replaced.

        Raises:
            InputError: a link, a fixed frame or an attached object has the same name.
        """
        return self.with_objects((item,))

    def with_objects(self, items: Iterable[CollisionObject]) -> PlanningScene:
        """Return the planning scene with several more objects.
        Existing objects with the same names are replaced.

        Raises:
            InputError: a link, a fixed frame or an attached object has the name of one of them.
        """
        items = list(items)
        for item in items:
            if not isinstance(item, CollisionObject):
                hint = f"for example {CollisionObject.WRITTEN_AS}"
                raise InputError(f"a scene consists of CollisionObjects, not of {item!r}", hint=hint)
        added = {item.name: item for item in items}
        for name in added:
            self.check_new_name(name)
        return replace(self, objects={**self.objects, **added})

    def check_new_name(self, name: str) -> None:
        """Raise an InputError if a name is already used in the planning scene, by a link,
        a fixed frame or an attached object.
        """
        if name in self.model.links or name == WORLD:
            raise InputError(f"object {name!r} has the name of a link", hint="give it another name")
        if name in self.fixed_frames:
            raise InputError(f"object {name!r} has the name of a fixed frame", hint="rename one of them")
        if name in self.attached:
            raise InputError(f"object {name!r} is attached to the robot", hint="detach it first")

    def with_object_pose(self, name: str, T_world_object: SE3) -> PlanningScene:
        if name not in self.objects:
            raise UnknownNameError("object", name, self.objects)
        return replace(self, objects={**self.objects, name: self.objects[name].at(T_world_object)})

    def without_object(self, name: str) -> PlanningScene:
        """Return the planning scene without a world object and its allowed-collision entries.

        The entries are removed because a later object of the same name is a different object.

        Raises:
            UnknownNameError: the world has no such object.
        """
        if name not in self.objects:
            raise UnknownNameError("object", name, self.objects)
        return without_allowed_entries(
            replace(self, objects={k: v for k, v in self.objects.items() if k != name}), name
        )

    def with_attached(self, name: str, link: str, touch_links: Iterable[str] = ()) -> PlanningScene:
        """Return the planning scene with a world object attached to a link at its current pose.

        Args:
            name: the object.
            link: a link, or a frame that moves with a link, such as a subframe of another attached object.
            touch_links: links that may touch the object, in addition to the link that carries it.
        Raises:
            UnknownNameError: the object, link or frame does not exist.
            InputError: the object contains a point cloud or an octree.
        """
        link = self.anchor(link)[0]
        if name not in self.objects:
            raise UnknownNameError("object", name, self.objects)
        touches = frozenset((link, *touch_links))
        for touch in touches:
            self.model.link(touch)
        item = self.objects[name]
        if item.has_cloud:
            raise InputError(f"object {name!r}: {CLOUDS_STAND}", hint=USE_A_SOLID)
        T_link_object = self.frame_pose(link).inverse() @ item.T_world_object
        body = AttachedBody(item, link, T_link_object, touches)
        rest = {k: v for k, v in self.objects.items() if k != name}
        return replace(self, objects=rest, attached={**self.attached, name: body})

    def with_detached(self, name: str) -> PlanningScene:
        """Return the planning scene with an attached object detached: it becomes a world object at its
        current pose.

        Raises:
            UnknownNameError: no attached object has this name.
        """
        if name not in self.attached:
            raise UnknownNameError("attached object", name, self.attached)
        item = self.attached[name].object.at(self.frame_pose(name))
        rest = {k: v for k, v in self.attached.items() if k != name}
        return replace(self, attached=rest, objects={**self.objects, name: item})

    # --- allowed collisions ---
    def with_allowed(self, a: str, b: str | Iterable[str], allow: bool = True) -> PlanningScene:
        """Return the planning scene in which contact between the given bodies is allowed or forbidden.

        Args:
            a: a link, world object or attached object.
            b: one or several bodies of the same kinds.
            allow: True to allow contact, False to forbid it.
        Raises:
            UnknownNameError: a body does not exist.
        """
        others = (b,) if isinstance(b, str) else tuple(b)
        known = [*self.model.links, *self.objects, *self.attached]
        for name in (a, *others):
            if name not in known:
                raise UnknownNameError("link or object", name, known)
        pairs = {frozenset((a, other)): allow for other in others}
        return replace(self, allowed_pairs={**self.allowed_pairs, **pairs})

    def with_default_allowed(self, name: str, allow: bool | None) -> PlanningScene:
        """Return the planning scene with a new default for a body,
        which allows or forbids contact with all other bodies.

        The default applies to pairs without an entry of their own, including bodies added later. If the
        defaults of two bodies disagree, their contact is not allowed, as in MoveIt.

        Args:
            name: a link, world object or attached object.
            allow: whether contact is allowed; None removes the default.
        Raises:
            UnknownNameError: the body does not exist.
        """
        known = [*self.model.links, *self.objects, *self.attached]
        if name not in known:
            raise UnknownNameError("link or object", name, known)
        defaults = {k: v for k, v in self.allowed_defaults.items() if k != name}
        return replace(self, allowed_defaults=defaults if allow is None else {**defaults, name: allow})

    @cached_property
    def allowed(self) -> Mapping[frozenset[str], bool]:
        """Return the collision pairs of the planning scene that are explicitly allowed (True) or forbidden
        (False).

        Per-body defaults are expanded to pairs.
        """
        return explicit_allowed_pairs(self) if self.allowed_defaults else self.allowed_pairs

    def is_allowed(self, a: str, b: str) -> bool:
        """Return whether collision checks ignore contact between two bodies of the planning scene."""
        pair = frozenset((a, b))
        if pair in self.allowed:
            return self.allowed[pair]
        for held, other in ((a, b), (b, a)):
            if held in self.attached and other in self.attached[held].touch_links:
                return True
        return pair in self.model.disabled_collisions

    def with_padding(self, padding: float | None = None, link_padding: Mapping[str, float] | None = None,
                     link_scale: Mapping[str, float] | None = None) -> PlanningScene:  # fmt: skip
        """Return the planning scene with padded links.
        The padding applies only to collision checks against objects.

        Args:
            padding: padding of all links [m]; None keeps the current value.
            link_padding: padding by link [m]; None keeps the current values.
            link_scale: scale factor by link, usually at least 1; None keeps the current values.
        Raises:
            InputError: a negative padding or a scale that is not positive.
            UnknownNameError: a link does not exist.
        """
        values = [padding or 0.0, *(link_padding or {}).values()]
        if any(not np.isfinite(v) or v < 0 for v in values):
            raise InputError("padding must be a number of meters >= 0")
        if any(not np.isfinite(v) or v <= 0 for v in (link_scale or {}).values()):
            raise InputError("scale must be a positive factor")
        for link in [*(link_padding or {}), *(link_scale or {})]:
            self.model.link(link)
        return replace(
            self,
            padding=self.padding if padding is None else padding,
            link_padding=self.link_padding if link_padding is None else dict(link_padding),
            link_scale=self.link_scale if link_scale is None else dict(link_scale),
        )

    # --- frames ---
    def with_fixed_frame(self, name: str, T_parent_frame: SE3, parent: str = WORLD) -> PlanningScene:
        """Return the planning scene with one more named frame, which is fixed in the world.

        Args:
            name: name of the frame.
            T_parent_frame: pose of the frame relative to `parent`.
            parent: frame whose current pose is used; later motions of `parent` do not move the new frame.
        Raises:
            InputError: a link or object has the same name.
            UnknownNameError: `parent` does not exist.
        """
        if not name or name in (WORLD, *self.model.links, *self.objects, *self.attached):
            raise InputError(f"fixed frame {name!r} has the name of a link or object", hint="rename it")
        T = self.frame_pose(parent) @ T_parent_frame
        return replace(self, fixed_frames={**self.fixed_frames, name: T})

    @property
    def frame_names(self) -> list[str]:
        """Return the names of all frames in a planning scene: world, links, fixed frames, objects and
        subframes of objects.
        """
        items = [*self.objects.values(), *(body.object for body in self.attached.values())]
        own = [name for item in items for name in (item.name, *(f"{item.name}/{s}" for s in item.subframes))]
        return [WORLD, *self.model.links, *self.fixed_frames, *own]

    def anchor(self, name: str) -> tuple[str, SE3]:
        """Return the link with which a frame of the planning scene moves, and the pose of the frame relative
        to this link.

        For a frame that is fixed in the world, the link is the robot's root link.

        Raises:
            UnknownNameError: the frame does not exist.
        """
        root = self.model.root_link
        if name == WORLD:
            return root, SE3.identity()
        if name in self.model.links:
            return name, SE3.identity()
        if name in self.fixed_frames:
            return root, self.fixed_frames[name]
        if name in self.objects:
            return root, self.objects[name].T_world_object
        if name in self.attached:
            return self.attached[name].link, self.attached[name].T_link_object
        for item in (*self.objects.values(), *(body.object for body in self.attached.values())):
            subframe = name[len(item.name) + 1 :]
            if name == f"{item.name}/{subframe}" and subframe in item.subframes:
                link, T = self.anchor(item.name)
                return link, T @ item.subframes[subframe]
        raise UnknownNameError("frame", name, self.frame_names)

    def frame_pose(self, name: str) -> SE3:
        """Return the pose T_world_frame of a link, object, subframe ("cup/handle") or fixed frame in a
        planning scene.

        Raises:
            UnknownNameError: the frame does not exist.
        """
        link, T_link_frame = self.anchor(name)
        if link == self.model.root_link:
            return T_link_frame
        return kinematic_tree(self.model).link_pose(self.positions, link) @ T_link_frame

    def transform(self, target: str, source: str) -> SE3:
        """Return the transform T_target_source between two frames of the planning scene, like TF's
        `lookup_transform`.
        """
        return self.frame_pose(target).inverse() @ self.frame_pose(source)

    # --- many changes at once ---
    def apply(self, diff: Change) -> PlanningScene:
        """Return the planning scene with all changes of a scene diff applied.

        Raises:
            InputError: a change cannot be applied; the message says which change and why.
        """
        return diff.applied_to(self)


def extent(scene: PlanningScene) -> tuple[NDArray[np.float64], float]:
    """Return the extent of a planning scene for the initial view of a viewer: center (3,) [m, world frame]
    and radius [m].

    The view covers the origins of all links and of all objects that extend less than 2 m from their origin;
    larger objects count as surroundings.
    """
    points = [*kinematic_tree(scene.model).link_transforms(scene.positions)[:, :3, 3]]
    points += [
        item.T_world_object.translation for item in scene.objects.values() if item.bounds()[1].max() < LARGE
    ]
    low, high = np.min(points, axis=0), np.max(points, axis=0)
    return (low + high) / 2, max(0.5, float(np.linalg.norm(high - low)) / 2)
