"""Robots: from URDF, xacro and SRDF to one frozen `RobotModel`; composing; the robot library."""

from armcell.model.assets import find_file
from armcell.model.compose import Part, compose, prefixed
from armcell.model.hand import hand_alone
from armcell.model.loader import load_robot, robot_names
from armcell.model.robot import (
    Collision,
    EndEffector,
    Gripper,
    Group,
    Inertial,
    Joint,
    JointLimits,
    Link,
    Mimic,
    RobotModel,
    Visual,
)
from armcell.model.setup import MoveItConfig, UrdfPart
from armcell.model.urdf import load_urdf, parse_urdf

__all__ = [
    "Collision",
    "EndEffector",
    "Gripper",
    "Group",
    "Inertial",
    "Joint",
    "JointLimits",
    "Link",
    "Mimic",
    "MoveItConfig",
    "Part",
    "RobotModel",
    "UrdfPart",
    "Visual",
    "compose",
    "find_file",
    "hand_alone",
    "load_robot",
    "load_urdf",
    "parse_urdf",
    "prefixed",
    "robot_names",
]
