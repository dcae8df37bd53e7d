"""`PlanningScene`: robot, state, objects, attached bodies and what may touch; an immutable value."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core import SE3, InputError, JointState, UnknownNameError
from armcell.core.checks import checked, float_array
from armcell.kinematics import kinematic_tree
from armcell.model import RobotModel
from armcell.scene.allowing import expanded, forgotten
from armcell.scene.objects import CLOUDS_STAND, USE_A_SOLID, CollisionObject

if TYPE_CHECKING:
    from armcell.scene.diff import SceneDiff

Array = NDArray[np.float64]
WORLD = "world"


@dataclass(frozen=True, eq=False)
class AttachedBody:
    """An object that moves with a link; `touch_links` may touch it."""

    object: CollisionObject
    link: str
    T_link_object: SE3
    touch_links: frozenset[str] = frozenset()


@dataclass(frozen=True, eq=False)
@checked()
class PlanningScene:
    """Everything a planner may know. `with_*()` return a changed copy; nothing is changed in place.

    The world frame is the frame of the robot's root link. `positions` (dof,) are in the model's order.
    """

    model: RobotModel
    positions: Array
    objects: Mapping[str, CollisionObject] = field(default_factory=dict)
    attached: Mapping[str, AttachedBody] = field(default_factory=dict)
    allowed_pairs: Mapping[frozenset[str], bool] = field(default_factory=dict)  # overrides the SRDF's pairs
    allowed_defaults: Mapping[str, bool] = field(default_factory=dict)  # of a body, where no pair says else
    padding: float = 0.0  # [m] around every link, against objects only
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
        """Another robot state (dof,), within limits."""
        return replace(
            self, positions=np.array(self.model.check_positions(positions, margin=1e-3), dtype=float)
        )

    def with_state(self, state: JointState) -> PlanningScene:
        """Some or all joints moved; the others stay."""
        return self.with_positions(self.state.updated(state).positions)

    # --- objects ---
    def object(self, name: str) -> CollisionObject:
        """An object, attached or not (an attached one at its present pose)."""
        if name in self.objects:
            return self.objects[name]
        if name in self.attached:
            return self.attached[name].object.at(self.frame_pose(name))
        raise UnknownNameError("object", name, [*self.objects, *self.attached])

    def with_object(self, item: CollisionObject) -> PlanningScene:
        """An object added, or replaced if one of that name is there.

        Raises:
            InputError: a link or an attached object has that name.
        """
        if item.name in self.model.links or item.name == WORLD:
            raise InputError(f"object {item.name!r} has the name of a link", cure="give it another name")
        if item.name in self.fixed_frames:
            raise InputError(f"object {item.name!r} has the name of a fixed frame", cure="rename one of them")
        if item.name in self.attached:
            raise InputError(f"object {item.name!r} is attached to the robot", cure="detach it first")
        return replace(self, objects={**self.objects, item.name: item})

    def with_object_pose(self, name: str, T_world_object: SE3) -> PlanningScene:
        if name not in self.objects:
            raise UnknownNameError("object", name, self.objects)
        return replace(self, objects={**self.objects, name: self.objects[name].at(T_world_object)})

    def without_object(self, name: str) -> PlanningScene:
        """Also forgets what the object was allowed to touch: another of that name is another object."""
        if name not in self.objects:
            raise UnknownNameError("object", name, self.objects)
        return forgotten(replace(self, objects={k: v for k, v in self.objects.items() if k != name}), name)

    def with_attached(self, name: str, link: str, touch_links: Iterable[str] = ()) -> PlanningScene:
        """An object taken from the world and fixed to a link where it now is.

        Args:
            link: or a frame that moves with one, such as a subframe of another held object.
        """
        link = self.anchor(link)[0]
        if name not in self.objects:
            raise UnknownNameError("object", name, self.objects)
        touches = frozenset((link, *touch_links))
        for touch in touches:
            self.model.link(touch)
        item = self.objects[name]
        if item.has_cloud:
            raise InputError(f"object {name!r}: {CLOUDS_STAND}", cure=USE_A_SOLID)
        T_link_object = self.frame_pose(link).inv() @ item.T_world_object
        body = AttachedBody(item, link, T_link_object, touches)
        rest = {k: v for k, v in self.objects.items() if k != name}
        return replace(self, objects=rest, attached={**self.attached, name: body})

    def with_detached(self, name: str) -> PlanningScene:
        """An attached object put back into the world where it now is."""
        if name not in self.attached:
            raise UnknownNameError("attached object", name, self.attached)
        item = self.attached[name].object.at(self.frame_pose(name))
        rest = {k: v for k, v in self.attached.items() if k != name}
        return replace(self, attached=rest, objects={**self.objects, name: item})

    # --- what may touch ---
    def with_allowed(self, a: str, b: str | Iterable[str], allow: bool = True) -> PlanningScene:
        """Allow (or forbid) contact between bodies: links, objects, attached objects."""
        others = (b,) if isinstance(b, str) else tuple(b)
        known = [*self.model.links, *self.objects, *self.attached]
        for name in (a, *others):
            if name not in known:
                raise UnknownNameError("link or object", name, known)
        pairs = {frozenset((a, other)): allow for other in others}
        return replace(self, allowed_pairs={**self.allowed_pairs, **pairs})

    def with_default_allowed(self, name: str, allow: bool | None) -> PlanningScene:
        """What holds for all pairs of a body that nothing else is said about, also with bodies added later.

        None forgets it. Where the two of a pair disagree, contact is not allowed (as in MoveIt).
        """
        known = [*self.model.links, *self.objects, *self.attached]
        if name not in known:
            raise UnknownNameError("link or object", name, known)
        defaults = {k: v for k, v in self.allowed_defaults.items() if k != name}
        return replace(self, allowed_defaults=defaults if allow is None else {**defaults, name: allow})

    @cached_property
    def allowed(self) -> Mapping[frozenset[str], bool]:
        """What was said by pair and, for the other pairs, by default."""
        return expanded(self) if self.allowed_defaults else self.allowed_pairs

    def is_allowed(self, a: str, b: str) -> bool:
        """Whether contact between two bodies is to be ignored."""
        pair = frozenset((a, b))
        if pair in self.allowed:
            return self.allowed[pair]
        for held, other in ((a, b), (b, a)):
            if held in self.attached and other in self.attached[held].touch_links:
                return True
        return pair in self.model.disabled_collisions

    def with_padding(self, padding: float | None = None, link_padding: Mapping[str, float] | None = None,
                     link_scale: Mapping[str, float] | None = None) -> PlanningScene:  # fmt: skip
        """Links grown against objects by metres (padding) or by a factor (scale, at least 1 makes sense)."""
        values = [padding or 0.0, *(link_padding or {}).values()]
        if any(not np.isfinite(v) or v < 0 for v in values):
            raise InputError("padding must be a number of metres >= 0")
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
        """A named frame that stands in the world, placed where it now is in `parent`.

        Raises:
            InputError: a link or object has that name.
        """
        if not name or name in (WORLD, *self.model.links, *self.objects, *self.attached):
            raise InputError(f"fixed frame {name!r} has the name of a link or object", cure="rename it")
        T = self.frame_pose(parent) @ T_parent_frame
        return replace(self, fixed_frames={**self.fixed_frames, name: T})

    @property
    def frame_names(self) -> list[str]:
        """Every frame there is: world, links, fixed frames, objects and their subframes."""
        items = [*self.objects.values(), *(body.object for body in self.attached.values())]
        own = [name for item in items for name in (item.name, *(f"{item.name}/{s}" for s in item.subframes))]
        return [WORLD, *self.model.links, *self.fixed_frames, *own]

    def anchor(self, name: str) -> tuple[str, SE3]:
        """The link that a frame moves with and T_link_frame; the root link for what stands in the world.

        Raises:
            UnknownNameError: no such frame.
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
        """T_world_frame of a link, an object (attached or not), a subframe ("cup/handle") or a fixed frame.

        Raises:
            UnknownNameError: no such frame.
        """
        link, T_link_frame = self.anchor(name)
        if link == self.model.root_link:
            return T_link_frame
        return kinematic_tree(self.model).link_pose(self.positions, link) @ T_link_frame

    def transform(self, target: str, source: str) -> SE3:
        """T_target_source, as TF's lookup_transform(target, source)."""
        return self.frame_pose(target).inv() @ self.frame_pose(source)

    # --- many changes at once ---
    def apply(self, diff: SceneDiff) -> PlanningScene:
        """All changes of a diff, or none.

        Raises:
            InputError: one of them cannot be made; says which and why.
        """
        return diff.applied_to(self)
