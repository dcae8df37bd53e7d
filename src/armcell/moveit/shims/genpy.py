"""Shim of genpy: time classes and the base class of messages."""

from armcell.moveit.message_classes import ScriptMessage as Message
from armcell.moveit.ros_time import Duration, Time

__all__ = ["Duration", "Message", "Time"]
