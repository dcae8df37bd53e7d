"""genpy: times and the base of messages."""

from armcell.moveit.message_classes import ScriptMessage as Message
from armcell.moveit.ros_time import Duration, Time

__all__ = ["Duration", "Message", "Time"]
