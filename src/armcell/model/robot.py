"""`RobotModel`, an immutable description of a robot, with its links, joints and groups.

The model contains no joint positions; robot states are separate objects.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core import SE3, InputError, JointState, Shape, UnknownNameError
from armcell.core.checks import checked, float_array
from armcell.model.grippers import Gripper

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
@checked()
class Inertial:
    mass: float  # [kg]
    T_link_com: SE3  # origin at the center of mass
    inertia: Array  # (3, 3) about the center of mass, in the com frame [kg m^2]


@dataclass(frozen=True, eq=False)
class Collision:
    shape: Shape
    T_link_shape: SE3


@dataclass(frozen=True, eq=False)
class Visual:
    """Visual geometry of a robot link: a primitive shape,
    or a mesh file that is loaded when the link is drawn.
    """

    T_link_visual: SE3
    shape: Shape | None = None
    file: Path | None = None
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    color: tuple[float, float, float, float] | None = None  # RGBA 0..1


@dataclass(frozen=True, eq=False)
class Link:
    name: str
    inertial: Inertial | None = None
    collisions: tuple[Collision, ...] = ()
    visuals: tuple[Visual, ...] = ()


@dataclass(frozen=True)
@checked("lower", "upper", "velocity", "acceleration", "jerk", "effort")
class JointLimits:
    """Limits of a joint in a robot model: position [rad or m], velocity, acceleration, jerk and effort [Nm or
    N].
    """

    lower: float = -np.inf
    upper: float = np.inf
    velocity: float = np.inf
    acceleration: float = np.inf
    jerk: float = np.inf
    effort: float = np.inf


@dataclass(frozen=True)
@checked()
class Mimic:
    """Rule by which a mimic joint of a robot follows another: `position = multiplier * position(other joint)
    + offset`.
    """

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


SERVO_ERROR = 1e-3  # [rad or m] from the target at which the friction of a joint may stop its servo


@dataclass(frozen=True)
@checked()
class Servo:
    """Gains of a joint's position servo in a robot model: force = kp (target - q) + kv (target speed -
    speed).
    """

    kp: float  # [Nm/rad or N/m]
    kv: float = 0.0  # [Nm s/rad or N s/m]


@dataclass(frozen=True)
class MjcfPart:
    """Part of a robot model that an MJCF file describes.

    Physics attaches the file's bodies with their own inertias, contact parameters, springs and equalities.

    Attributes:
        text: the MJCF, without includes and relative paths.
        root: link of the MJCF's world frame or of its only base body, with the prefix.
        links: the part's links, with the prefix.
        prefix: before each name of the text.
        states: joint positions [rad or m] of each named keyframe, by joint name with the prefix.
    """

    text: str = field(repr=False)
    root: str
    links: frozenset[str] = field(repr=False)
    prefix: str = ""
    states: Mapping[str, Mapping[str, float]] = field(default_factory=dict, repr=False, compare=False)

    def prefixed(self, prefix: str) -> MjcfPart:
        """Return a copy of the MJCF part of a robot model with `prefix` before every name."""
        return replace(
            self,
            root=prefix + self.root,
            links=frozenset(prefix + name for name in self.links),
            prefix=prefix + self.prefix,
            states={s: {prefix + j: q for j, q in of.items()} for s, of in self.states.items()},
        )


@dataclass(frozen=True, eq=False)
@checked()
class Joint:
    """Joint between two links of a robot. It is fixed or has one degree of freedom.

    The movable types are revolute, continuous and prismatic.
    """

    name: str
    type: str
    parent: str
    child: str
    T_parent_joint: SE3
    axis: tuple[float, float, float] = (1.0, 0.0, 0.0)  # unit, in the joint frame
    limits: JointLimits = JointLimits()
    mimic: Mimic | None = None
    damping: float = 0.0
    friction: float = 0.0
    servo: Servo | None = None  # of the model's own actuator, if that is a position servo

    @property
    def movable(self) -> bool:
        return self.type != "fixed"

    @property
    def actuated(self) -> bool:
        return self.movable and self.mimic is None


@dataclass(frozen=True)
class Group:
    """Planning group of a robot model, with its actuated joints, its links, and its base and tip link.

    Attributes:
        ik_solver: name of the inverse kinematics solver; empty: armcell chooses one.
    """

    name: str
    joint_names: tuple[str, ...]
    link_names: tuple[str, ...]
    base_link: str | None = None
    tip_link: str | None = None
    ik_solver: str = ""


@dataclass(frozen=True)
class EndEffector:
    """End effector of a robot model, as in the SRDF. It is a gripper group mounted on a link of the robot.

    Attributes:
        group: planning group of the gripper.
        parent_link: link that carries the gripper.
        parent_group: planning group of the arm that moves the gripper, if the SRDF names one.
    """

    name: str
    group: str
    parent_link: str
    parent_group: str | None = None


@dataclass(frozen=True, eq=False)
class RobotModel:
    """Model of a robot: its tree of links and joints, its planning groups, end effectors and allowed
    collisions.

    `joint_names` is the canonical order of the actuated joints: depth first from the root, children in file
    order. Every position vector `q` without names has this order.
    """

    name: str
    root_link: str
    links: Mapping[str, Link]
    joints: Mapping[str, Joint]  # topological order
    groups: Mapping[str, Group] = field(default_factory=dict)
    end_effectors: Mapping[str, EndEffector] = field(default_factory=dict)
    grippers: Mapping[str, Gripper] = field(default_factory=dict)
    named_states: Mapping[str, Mapping[str, Mapping[str, float]]] = field(default_factory=dict)
    disabled_collisions: Mapping[frozenset[str], str] = field(default_factory=dict)
    source: str = ""
    mjcf: tuple[MjcfPart, ...] = ()  # parts that physics takes from MJCF text
    frames: Mapping[str, Joint] = field(default_factory=dict)  # links that robot.yaml or setup added, fixed

    @cached_property
    def joint_names(self) -> tuple[str, ...]:
        return tuple(j.name for j in self.joints.values() if j.actuated)

    @cached_property
    def movable_joint_names(self) -> tuple[str, ...]:
        """Return the names of all joints of the robot that are not fixed, which are the actuated and the
        mimic joints.
        """
        return tuple(j.name for j in self.joints.values() if j.movable)

    @cached_property
    def parent_joint(self) -> Mapping[str, Joint]:
        """Return the parent joint of each link of the robot model, by link name. The root link has none."""
        return {j.child: j for j in self.joints.values()}

    @cached_property
    def _column(self) -> Mapping[str, int]:
        """Return the index in `joint_names` for each actuated joint of the robot model, by joint name."""
        return {name: i for i, name in enumerate(self.joint_names)}

    @property
    def dof(self) -> int:
        return len(self.joint_names)

    def link(self, name: str) -> Link:
        if name not in self.links:
            raise UnknownNameError("link", name, self.links)
        return self.links[name]

    def joint(self, name: str) -> Joint:
        if name not in self.joints:
            raise UnknownNameError("joint", name, self.joints)
        return self.joints[name]

    def group(self, name: str) -> Group:
        if name not in self.groups:
            raise UnknownNameError("planning group", name, self.groups)
        return self.groups[name]

    def gripper(self, name: str | None = None, arm_group: str | None = None) -> Gripper:
        """Return a gripper of the robot model by its name or by the group of its arm.
        If there is only one gripper, no name is needed.

        Raises:
            UnknownNameError: the robot has no gripper of that name.
            InputError: without a name, not exactly one gripper matches.
        """
        if name is not None:
            if name not in self.grippers:
                raise UnknownNameError("gripper", name, self.grippers)
            return self.grippers[name]
        fitting = [g for g in self.grippers.values() if arm_group in (None, g.arm_group)]
        if len(fitting) != 1:
            of = f" of group {arm_group!r}" if arm_group else ""
            raise InputError(
                f"robot {self.name!r} has {len(fitting)} grippers{of}",
                hint=f"name one of {sorted(self.grippers)}",
            )
        return fitting[0]

    @property
    def arm_groups(self) -> tuple[str, ...]:
        """Return the planning groups of the robot's arms by name: those that carry a gripper or, if no arm
        does, all kinematic chains.
        """
        carrying = dict.fromkeys(g.arm_group for g in self.grippers.values())
        return tuple(carrying or (g.name for g in self.groups.values() if g.tip_link and g.joint_names))

    def columns(self, joint_names: Iterable[str]) -> list[int]:
        """Return the indices of the given joints in `joint_names` of the robot model.

        Raises:
            UnknownNameError: a name is not an actuated joint of this robot.
        """
        at, columns = self._column, []
        for name in joint_names:
            if name not in at:
                raise UnknownNameError("actuated joint", name, at)
            columns.append(at[name])
        return columns

    @cached_property
    def lower(self) -> Array:
        return np.array([self.joints[n].limits.lower for n in self.joint_names])

    @cached_property
    def upper(self) -> Array:
        return np.array([self.joints[n].limits.upper for n in self.joint_names])

    def limits(self, joint_names: Iterable[str], kind: str) -> Array:
        """Return the limits (n,) of one kind, such as "velocity", for given joints of the robot model.

        Args:
            joint_names: the n joints.
            kind: "lower", "upper", "velocity", "acceleration", "jerk" or "effort".
        """
        return np.array([getattr(self.joint(n).limits, kind) for n in joint_names])

    def neutral(self) -> Array:
        """Return the zero positions (dof,) of the robot model.
        If a joint's limits exclude zero, its position is mid-range.
        """
        low = np.where(np.isfinite(self.lower), self.lower, -np.inf)
        high = np.where(np.isfinite(self.upper), self.upper, np.inf)
        bounded = np.isfinite(low) & np.isfinite(high)
        middle = np.where(bounded, (np.where(bounded, low, 0.0) + np.where(bounded, high, 0.0)) / 2, 0.0)
        return np.where((low <= 0) & (high >= 0), 0.0, middle)

    def named_state(self, group: str, name: str) -> JointState:
        """Return a named state of a planning group in the robot model (`group_state` in the SRDF).

        Raises:
            UnknownNameError: the group or the state does not exist.
        """
        self.group(group)
        states = self.named_states.get(group, {})
        if name not in states:
            raise UnknownNameError(f"named state of group {group!r}", name, states)
        return JointState.from_mapping(states[name])

    def default_positions(self) -> Array:
        """Return the default joint positions (dof,) [rad or m] of the robot model.

        The positions are `neutral()`, with each group's "home" state applied; a group without "home" uses
        "ready", "default" or "open" instead, if one exists.
        """
        q = self.neutral()
        for group in self.groups:
            states = self.named_states.get(group, {})
            for name in ("home", "ready", "default", "open"):
                if name in states:
                    for joint, value in states[name].items():
                        q[self.columns((joint,))[0]] = value
                    break
        return q

    def check_positions(
        self, q: ArrayLike, joint_names: Iterable[str] | None = None, margin: float = 1e-9
    ) -> Array:
        """Check joint positions [rad or m] against the limits of the robot model and return them as an array
        (n,).

        Args:
            q: the positions.
            joint_names: joints of the positions; by default all actuated joints.
            margin: tolerance at the limits [rad or m].
        Raises:
            InputError: wrong length, a non-finite value, or a position outside the limits (the message names
                the joint, value and limit).
        """
        names = tuple(joint_names) if joint_names is not None else self.joint_names
        values = float_array(q, None, "positions", finite=False)
        if values.shape != (len(names),):
            raise InputError(f"{values.shape} positions given for {len(names)} joints of {self.name!r}")
        for name, value in zip(names, values, strict=True):
            limits = self.joint(name).limits
            if not np.isfinite(value):
                raise InputError(f"position of joint {name!r} is not finite")
            if not limits.lower - margin <= value <= limits.upper + margin:
                raise InputError(
                    f"joint {name!r} at {value:.4g} is outside its limits "
                    f"[{limits.lower:.4g}, {limits.upper:.4g}]"
                )
        return values

    def enforce_bounds(self, q: ArrayLike, joint_names: Iterable[str] | None = None) -> Array:
        """Clip joint positions [rad or m] to the limits of the robot model. Continuous joints are wrapped to
        (-pi, pi].

        Raises:
            InputError: wrong length or a non-finite value.
        """
        names = tuple(joint_names) if joint_names is not None else self.joint_names
        values = np.array(float_array(q, None, "positions", finite=False))
        if values.shape != (len(names),) or not np.all(np.isfinite(values)):
            raise InputError(f"{len(names)} finite positions are needed for {self.name!r}, not {q}")
        turns = np.array([self.joint(name).type == "continuous" for name in names], dtype=bool)
        values[turns] = np.pi - np.remainder(np.pi - values[turns], 2 * np.pi)
        return np.clip(values, self.limits(names, "lower"), self.limits(names, "upper"))

    def subtree(self, link: str) -> tuple[str, ...]:
        """Return the names of a link of the robot model and of all links below it, starting with the link
        itself.
        """
        self.link(link)
        found = [link]
        for joint in self.joints.values():  # one pass is enough: joints are in topological order
            if joint.parent in found:
                found.append(joint.child)
        return tuple(found)

    def chain(self, base: str, tip: str) -> tuple[Joint, ...]:
        """Return the joints of the robot model on the path from link `base` down to link `tip`, starting at
        `base`.

        Raises:
            InputError: `tip` is not below `base`.
        """
        self.link(base)
        self.link(tip)
        joints: list[Joint] = []
        link = tip
        while link != base:
            if link not in self.parent_joint:
                raise InputError(f"link {tip!r} is not below link {base!r}")
            joints.append(self.parent_joint[link])
            link = joints[-1].parent
        return tuple(reversed(joints))

    def coupling(self, joint: str) -> tuple[str, float, float]:
        """Return the driven joint that moves a joint of the robot model, directly or through mimic joints,
        with the multiplier and the offset: position = multiplier * driven position + offset.

        Raises:
            UnknownNameError: the robot model has no such joint.
        """
        source, multiplier, offset = self.joint(joint), 1.0, 0.0
        while source.mimic is not None:
            offset += multiplier * source.mimic.offset
            multiplier *= source.mimic.multiplier
            source = self.joints[source.mimic.joint]
        return source.name, multiplier, offset

    def pose_at_zero(self, base: str, link: str) -> SE3:
        """Return the pose T_base_link of a link of the robot model below link `base`, with all joints between
        them at zero.

        Raises:
            InputError: `link` is not below `base`.
        """
        T = SE3.identity()
        for joint in self.chain(base, link):
            T = T @ joint.T_parent_joint
        return T

    @cached_property
    def rigid_groups(self) -> tuple[frozenset[str], ...]:
        """Return the sets of links in the robot model that fixed joints connect rigidly."""
        of: dict[str, set[str]] = {self.root_link: {self.root_link}}
        for joint in self.joints.values():
            if joint.movable:
                of[joint.child] = {joint.child}
            else:
                of[joint.child] = of[joint.parent]
                of[joint.parent].add(joint.child)
        return tuple({id(s): frozenset(s) for s in of.values()}.values())
