"""Robot models: load URDF, xacro and SRDF files into immutable robots, and combine robots.

The package also contains the library of robots that `load_robot` finds by name.
"""

from armcell.model.assets import find_file
from armcell.model.composition import MountedRobot, compose, hand_alone, prefixed
from armcell.model.grippers import Gripper, SuctionCup, SuctionGripper
from armcell.model.loader import KnownRobot, installed_robots, known_robot, load_robot, robot_names
from armcell.model.robot import (
    Collision,
    EndEffector,
    Group,
    Inertial,
    Joint,
    JointLimits,
    Link,
    Mimic,
    RobotModel,
    Visual,
)
from armcell.model.setup import MoveItConfig, UrdfPart, load_ompl_planning
from armcell.model.urdf import load_urdf, parse_urdf

__all__ = [
    "Collision",
    "EndEffector",
    "Gripper",
    "Group",
    "Inertial",
    "Joint",
    "JointLimits",
    "KnownRobot",
    "Link",
    "Mimic",
    "MountedRobot",
    "MoveItConfig",
    "RobotModel",
    "SuctionCup",
    "SuctionGripper",
    "UrdfPart",
    "Visual",
    "compose",
    "find_file",
    "hand_alone",
    "installed_robots",
    "known_robot",
    "load_ompl_planning",
    "load_robot",
    "load_urdf",
    "parse_urdf",
    "prefixed",
    "robot_names",
]
