"""Grippers of a robot: jaws with one driven joint, and suction cups.

A suction gripper needs no joint. Its description follows the vendors' data sheets: the radius of a cup's
sealing ring, the stroke of its lip and the vacuum of the ejector.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from armcell.core import SE3, InputError, JointState, Shape
from armcell.core.checks import checked
from armcell.core.geometry import extent

Array = NDArray[np.float64]

MAX_STROKE = 0.004  # [m] physics tests a cup for contact up to this distance
RING_THICKNESS = 0.001  # [m] a rigid shape of a cup ends this far behind the ring
ATMOSPHERE = 101.3  # [kPa]
VACUUM_OFF = 0.01  # [m] width that a suction gripper reports while its vacuum is off


@dataclass(frozen=True, kw_only=True)
@checked()
class Gripper:
    """Gripper of a robot: hand links, a tcp frame and possibly one driven joint.

    The z axis of the tcp frame points out of the hand. Two jaws (`finger_links`) close along its y axis;
    `SuctionGripper` holds with cups instead. `width` [m] is the gap between the finger pads. With sliding
    fingers, `width = width_per_joint * q + width_offset`, with `q` the position of the driven joint. For a
    linkage or a single moving jaw, `curve` tabulates the width, and the center of the grip, which moves as
    the jaws close; `width_per_joint` [m/rad] is then the mean slope.
    """

    name: str
    arm_group: str
    group: str
    joint_name: str = ""  # driven joint; empty: the gripper has none
    tcp_link: str
    finger_links: tuple[str, ...] = ()
    hand_links: tuple[str, ...]  # links that may be near the grasped object: palm and fingers or cups
    width_per_joint: float = 2.0
    width_offset: float = 0.0
    max_width: float = 0.08  # [m]
    max_force: float = 70.0  # [N] per finger or cup
    finger_depth: float = 0.02  # [m] usable finger length from the tcp toward the palm
    pad_depth: float = 0.01  # [m] finger length beyond the tcp
    # Rows, from closed to open: joint position, width [m], y and z of the grip center in the tcp frame [m].
    curve: tuple[tuple[float, ...], ...] = ()
    pad: tuple[float, ...] = ()  # [m] lowest x and z, highest x and z of the pads; empty: from the meshes

    def __post_init__(self) -> None:
        if type(self) is Gripper and not (self.joint_name and self.finger_links):
            raise InputError(f"gripper {self.name!r} is incomplete: jaws need joint_name and finger_links")

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Return the driven joints of a gripper: one, or none."""
        return (self.joint_name,) if self.joint_name else ()

    @property
    def contact_links(self) -> tuple[str, ...]:
        """Return the links with which a gripper holds an object: its fingers or cups."""
        return self.finger_links

    @property
    def summary(self) -> str:
        """Describe what a gripper can do, in a few words."""
        return f"opens {1000 * self.max_width:.0f} mm, {self.max_force:.0f} N per finger"

    def width_in(self, state: JointState) -> float:
        """Return the gap [m] between a gripper's fingers in a joint state, or `max_width` if the gripper has
        no driven joint.
        """
        return self.width(state[self.joint_name]) if self.joint_name else self.max_width

    def prefixed(self, prefix: str) -> Self:
        """Return a copy of a gripper with `prefix` before every name."""
        return replace(
            self,
            name=prefix + self.name,
            arm_group=prefix + self.arm_group,
            group=prefix + self.group,
            joint_name=prefix + self.joint_name if self.joint_name else "",
            tcp_link=prefix + self.tcp_link,
            finger_links=tuple(prefix + link for link in self.finger_links),
            hand_links=tuple(prefix + link for link in self.hand_links),
        )

    @cached_property
    def _table(self) -> Array:
        """Return a gripper's opening curve, which maps its joint position to its width and grip center, as an
        array (4, k) with one column per joint position.

        The rows are the joint position, the width [m], and y and z of the grip center in the tcp frame [m].
        """
        return np.array(self.curve, dtype=float).reshape(-1, 4).T

    def joint_position(self, width: float) -> float:
        """Return the position of a gripper's driven joint at which the
        gap between the pads has a given width [m].
        """
        if self.curve:
            return float(np.interp(width, self._table[1], self._table[0]))
        return (width - self.width_offset) / self.width_per_joint

    def width(self, joint_position: float) -> float:
        """Return the gap [m] between a gripper's pads for a given position of the driven joint."""
        if self.curve:
            ways = np.sign(self._table[0, -1] - self._table[0, 0])
            return float(np.interp(ways * joint_position, ways * self._table[0], self._table[1]))
        return joint_position * self.width_per_joint + self.width_offset

    def center(self, width: float) -> SE3:
        """Return T_tcp_center, the pose of the grip center of a robot's gripper,
        for a gap [m] between the pads.
        """
        if not self.curve:
            return SE3.identity()
        return SE3.from_xyz(0.0, *(float(np.interp(width, self._table[1], self._table[k])) for k in (2, 3)))

    def grip_center(self, width: float, opening: float) -> SE3:
        """Return T_tcp_center, the pose of a gripper's grip center in its tcp frame, for an object of `width`
        [m]. `opening` [m] is the gap between the jaws during the approach.

        A single moving jaw approaches with the object centered between the jaws.
        """
        closed, opened = self.center(width).translation, self.center(opening).translation
        return SE3.from_xyz(0.0, float(opened[1]), float(closed[2]))

    @property
    def finger_travel_per_joint(self) -> float:
        """How far a gripper's finger moves when the driven joint moves by one unit.
        It is 1 for symmetric sliding fingers.
        """
        return abs(self.width_per_joint) / 2


@dataclass(frozen=True)
@checked()
class SuctionCup:
    """Suction cup of a gripper, on a link of the robot model.

    The z axis of the cup's frame points out of the cup. Its origin is the center of the ring on which a held
    surface rests. The free lip reaches `stroke` beyond this ring and seals on any surface within its reach.
    """

    link: str
    radius: float  # [m] of the ring
    stroke: float = 0.002  # [m]
    xyz: tuple[float, ...] = (0.0, 0.0, 0.0)  # [m] origin of the cup's frame in the link's frame
    rpy: tuple[float, ...] = (0.0, 0.0, 0.0)  # [rad]

    def __post_init__(self) -> None:
        if not (self.radius > 0 and 0 < self.stroke <= MAX_STROKE):
            text = f"cup on {self.link!r} has radius {self.radius:g} m and stroke {self.stroke:g} m"
            raise InputError(text, hint=f"both must be positive, the stroke at most {MAX_STROKE} m")
        if len(self.xyz) != 3 or len(self.rpy) != 3:
            raise InputError(f"cup on {self.link!r}: xyz and rpy need three numbers each")

    @property
    def T_link_cup(self) -> SE3:
        return SE3.from_xyz_rpy(self.xyz, self.rpy)

    def lip_reaches(self, shape: Shape, T_link_shape: SE3) -> bool:
        """Return whether a collision shape of a suction cup's link includes the flexible lip of the cup.

        Descriptions of cups usually end at the free lip, in front of the ring. In physics, the ring replaces
        such a shape.
        """
        T = self.T_link_cup.inverse() @ T_link_shape
        return extent(shape, T.rotation.matrix[2])[1] + T.translation[2] > 1e-6 - RING_THICKNESS

    @property
    def area(self) -> float:
        """Return the area [m^2] inside the ring of a gripper's suction cup."""
        return float(np.pi * self.radius**2)


@dataclass(frozen=True, kw_only=True)
@checked()
class SuctionGripper(Gripper):
    """Suction gripper of a robot, which holds an object by the vacuum in its cups. Each cup has its own valve
    or ejector.

    Width 0 turns the vacuum on, and any larger width turns it off. The origin of the tcp frame is in the
    plane of the cups' rings. `max_force` is the mean holding force of a cup.
    """

    cups: tuple[SuctionCup, ...]
    vacuum: float = 60.0  # [kPa] below ambient pressure
    evacuation: float = 0.1  # [s] time constant with which a sealed cup reaches its vacuum
    safety: float = 2.0  # factor on the load for which grasps are planned

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.cups:
            raise InputError(f"gripper {self.name!r} has no cups")
        if not (0 < self.vacuum <= ATMOSPHERE and self.evacuation > 0 and self.safety >= 1):
            raise InputError(
                f"gripper {self.name!r} has vacuum {self.vacuum:g} kPa, evacuation {self.evacuation:g} s and "
                f"safety {self.safety:g}",
                hint=f"vacuum: at most {ATMOSPHERE} kPa; evacuation: above 0; safety: at least 1",
            )
        mean = sum(self.force(cup) for cup in self.cups) / len(self.cups)
        object.__setattr__(self, "max_force", mean)
        object.__setattr__(self, "max_width", VACUUM_OFF)

    @property
    def contact_links(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(cup.link for cup in self.cups))

    @property
    def summary(self) -> str:
        n, pulls = len(self.cups), sum(map(self.force, self.cups))
        return f"{n} suction cup{'s' if n > 1 else ''}, {self.vacuum:g} kPa, {pulls:.0f} N together"

    def prefixed(self, prefix: str) -> Self:
        cups = tuple(replace(cup, link=prefix + cup.link) for cup in self.cups)
        return replace(super().prefixed(prefix), cups=cups)

    def force(self, cup: SuctionCup) -> float:
        """Return the largest force [N] with which a suction gripper's cup pulls: pressure times area."""
        return 1000.0 * self.vacuum * cup.area
