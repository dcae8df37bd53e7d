"""What a motion or its goal must keep to: positions, orientations, joints; as moveit_msgs/Constraints."""

from __future__ import annotations

from dataclasses import dataclass

from armcell.core.checks import checked
from armcell.core.geometry import Shape
from armcell.core.transforms import SE3, SO3

WORLD = "world"


@dataclass(frozen=True)
@checked()
class JointConstraint:
    """One joint between position - tolerance_below and position + tolerance_above [rad or m]."""

    joint: str
    position: float
    tolerance_above: float
    tolerance_below: float


@dataclass(frozen=True, eq=False)
@checked()
class PositionConstraint:
    """A point of a link in a region: inside any one of its shapes."""

    region: tuple[tuple[Shape, SE3], ...]  # (shape, T_frame_shape)
    link: str | None = None  # the group's tip where None; also an attached object or a subframe
    point: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m] in the link's frame
    frame: str = WORLD


@dataclass(frozen=True, eq=False)
@checked()
class OrientationConstraint:
    """A link turned as wanted, up to a tolerance about each axis [rad]; pi or more leaves that axis free.

    The error is the rotation from the wanted to the present orientation, in the wanted one's axes: as a
    rotation vector, or as intrinsic x-y-z Euler angles (MoveIt's default, with its singularity at 90 deg
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
    """A disc that a sensor sees: no link of the robot is in the cone from the sensor's origin to the disc.

    The sensor's own link and the one that carries the disc do not count, nor does what is attached (as in
    MoveIt). Objects of the world are not looked at.
    """

    sensor: str  # link or frame that carries the sensor
    T_frame_target: SE3  # the disc's centre; its z is the side that is to be seen
    target_radius: float  # [m]
    frame: str = WORLD  # of the target
    T_link_sensor: SE3 = SE3.identity()  # where the sensor is in its frame
    view_axis: str = "z"  # of the sensor: the way it looks; or "x"
    max_view_angle: float | None = None  # [rad] between the way it looks and the disc's axis; None: any
    max_range_angle: float | None = None  # [rad] between the way it looks and the disc's centre; None: any
    cone_sides: int = 16  # of the pyramid that stands for the cone


@dataclass(frozen=True, eq=False)
class Constraints:
    """All of them at once."""

    joints: tuple[JointConstraint, ...] = ()
    positions: tuple[PositionConstraint, ...] = ()
    orientations: tuple[OrientationConstraint, ...] = ()
    name: str = ""
    visibilities: tuple[VisibilityConstraint, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.joints or self.positions or self.orientations or self.visibilities)
