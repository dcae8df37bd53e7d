"""moveit_commander, rospy and the like in front of the bus: users' scripts run with no ROS installed."""

from armcell.moveit.run import INTERRUPTED, run_script
from armcell.moveit.session import Session, current_session

__all__ = ["INTERRUPTED", "Session", "current_session", "run_script"]
