"""Messages, the in-process bus and the wires (Unity; later ROS 1, ROS 2), with nothing of ROS installed."""

from armcell.ros.codec import Codec, WireError, cdr, ros1
from armcell.ros.messages import Message
from armcell.ros.schema import Schema, schema

__all__ = [
    "Codec",
    "Message",
    "Schema",
    "WireError",
    "cdr",
    "ros1",
    "schema",
]
