"""Shim of moveit_commander: groups, planning scene and robot, based on the bus's move_group.

Source of names, defaults, exceptions and quirks: moveit_commander of MoveIt 1 (Noetic).
"""

from armcell.moveit.shims.moveit_commander import conversions, exception
from armcell.moveit.shims.moveit_commander.exception import MoveItCommanderException
from armcell.moveit.shims.moveit_commander.move_group import MoveGroupCommander
from armcell.moveit.shims.moveit_commander.planning_scene_interface import PlanningSceneInterface
from armcell.moveit.shims.moveit_commander.planning_scene_monitor import PlanningSceneMonitor
from armcell.moveit.shims.moveit_commander.robot import RobotCommander
from armcell.moveit.shims.moveit_commander.roscpp_initializer import roscpp_initialize, roscpp_shutdown

__all__ = [
    "MoveGroupCommander",
    "MoveItCommanderException",
    "PlanningSceneInterface",
    "PlanningSceneMonitor",
    "RobotCommander",
    "conversions",
    "exception",
    "roscpp_initialize",
    "roscpp_shutdown",
]
