"""Messages, the in-process bus and the wires (Unity; later ROS 1, ROS 2), with nothing of ROS installed."""

from armcell.ros.actions import ActionClient, ActionServer, Done, State
from armcell.ros.bus import Bus, Publisher, ServiceError, Subscription
from armcell.ros.codec import Codec, WireError, cdr, ros1
from armcell.ros.messages import Message
from armcell.ros.schema import Schema, schema

__all__ = [
    "ActionClient",
    "ActionServer",
    "Bus",
    "Codec",
    "Done",
    "Message",
    "Publisher",
    "Schema",
    "ServiceError",
    "State",
    "Subscription",
    "WireError",
    "cdr",
    "ros1",
    "schema",
]
