"""Constraints on a robot's motion or its goal, as in moveit_msgs/Constraints."""

from __future__ import annotations

from dataclasses import dataclass

from armcell.core.checks import checked
from armcell.core.geometry import Shape
from armcell.core.transforms import SE3, SO3

WORLD = "world"


@dataclass(frozen=True)
@checked()
class JointConstraint:
    """Constraint that keeps a joint within tolerances [rad or m] of a desired position.

    The joint stays between position - tolerance_below and position + tolerance_above.
    """

    joint: str
    position: float
    tolerance_above: float
    tolerance_below: float


@dataclass(frozen=True, eq=False)
@checked()
class PositionConstraint:
    """Constraint that keeps a point of a link inside a region, that is, inside at least one of the region's
    shapes.
    """

    region: tuple[tuple[Shape, SE3], ...]  # (shape, T_frame_shape)
    link: str | None = None  # default: the group's tip; also an attached object or a subframe
    point: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m] in the link's frame
    frame: str = WORLD


@dataclass(frozen=True, eq=False)
@checked()
class OrientationConstraint:
    """Constraint that keeps the orientation of a link within a tolerance [rad] about each axis.

    A tolerance of pi or more frees its axis.

    The error is the rotation from the desired to the current orientation, in the axes of the desired
    orientation: a rotation vector, or intrinsic x-y-z Euler angles (MoveIt's default, singular at 90 deg
    about y).
    """

    rotation: SO3  # R_frame_link
    tolerance: tuple[float, float, float]  # [rad], absolute
    link: str | None = None
    frame: str = WORLD
    parameterization: str = "rotation_vector"  # or "xyz_euler"


@dataclass(frozen=True, eq=False)
@checked()
class VisibilityConstraint:
    """Constraint that keeps the view cone from a sensor to a target disc free of the robot's links.

    The sensor's own link, the link that carries the disc, and attached objects do not count (as in MoveIt).
    World objects are not checked.
    """

    sensor: str  # link or frame that carries the sensor
    T_frame_target: SE3  # the disc's center; its z axis points to the visible side
    target_radius: float  # [m]
    frame: str = WORLD  # of the target
    T_link_sensor: SE3 = SE3.identity()  # sensor pose in the frame of `sensor`
    view_axis: str = "z"  # viewing axis of the sensor: "z" or "x"
    max_view_angle: float | None = None  # [rad] between viewing axis and disc axis; None: any
    max_range_angle: float | None = None  # [rad] between viewing axis and disc center; None: any
    cone_sides: int = 16  # sides of the pyramid that approximates the cone


@dataclass(frozen=True, eq=False)
class Constraints:
    """Set of constraints on the motion of a robot or on its goal; all of them must hold at the same time."""

    joints: tuple[JointConstraint, ...] = ()
    positions: tuple[PositionConstraint, ...] = ()
    orientations: tuple[OrientationConstraint, ...] = ()
    name: str = ""
    visibilities: tuple[VisibilityConstraint, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.joints or self.positions or self.orientations or self.visibilities)
