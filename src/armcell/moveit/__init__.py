"""moveit_commander, rospy and the like in front of the bus: users' scripts run with no ROS installed."""

from armcell.moveit.run import run_script
from armcell.moveit.session import Session, current_session

__all__ = ["Session", "current_session", "run_script"]
