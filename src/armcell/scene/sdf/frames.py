"""SDF 1.7 pose semantics: `relative_to`, <frame>, nested models and placement frames."""

from __future__ import annotations

from dataclasses import dataclass, field

from armcell.core import SE3
from armcell.scene.sdf.elements import Element, fail, pose_of

ROOTS = ("", "__model__", "world")
MAX_DEPTH = 256  # longest chain of frames relative to each other


@dataclass
class _Frame:
    element: Element
    parent: str  # the frame that `T_parent_frame` is relative to
    T_parent_frame: SE3


@dataclass
class Scope:
    """Named frames of one SDF world or model. Each has a pose relative to another frame."""

    frames: dict[str, _Frame] = field(default_factory=dict)
    inner: dict[str, Scope] = field(default_factory=dict)  # nested models
    found: dict[str, SE3] = field(default_factory=dict)
    is_world: bool = False

    def add(
        self, element: Element, name: str, default: str = "", pose: Element | None = None,
        T_pose_frame: SE3 | None = None,
    ) -> None:  # fmt: skip
        """Add the frame of an SDF link, <frame>, joint or model to the frames of the world or model that
        contains it.

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
        """Return the pose of an SDF frame, such as `model::link`, relative to the world or model that
        contains it.

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
        """Return the pose in an SDF <pose> element relative to the frame `base`.

        The <pose> may itself name another frame with `relative_to`; by default it is relative to `base`.
        """
        named = "" if pose is None else pose.get("relative_to") or pose.get("frame") or ""
        T = pose_of(pose)
        if named in ("", base):
            return T
        return self.pose(base, asked_by).inverse() @ self.pose(named, asked_by) @ T
