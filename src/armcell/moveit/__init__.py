"""Execution of users' moveit_commander and rospy scripts on the armcell bus, without ROS."""

from armcell.moveit.run import run_script
from armcell.moveit.session import Session, current_session

__all__ = ["Session", "current_session", "run_script"]
