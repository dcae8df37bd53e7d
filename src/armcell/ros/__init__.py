"""ROS messages, an in-process bus, and transports to Unity, ROS 1 and ROS 2.

The package needs no ROS installation.
"""

from typing import TYPE_CHECKING, Any

from armcell.ros.actions import ActionClient, ActionServer, Done, State
from armcell.ros.bus import Bus, Publisher, ServiceError, Subscription
from armcell.ros.codec import Codec, WireError, cdr
from armcell.ros.messages import Message
from armcell.ros.names import NameMap
from armcell.ros.ros1 import Ros1Graph, Ros1Master, Ros1Settings
from armcell.ros.schema import Schema, schema
from armcell.ros.tcp import Bridge, RosTcpClient, RosTcpServer, ServerSettings

if TYPE_CHECKING:
    from armcell.ros.nodes import CellNode, ServedCell, ServedPlanner
    from armcell.ros.ros2 import Reach, Ros2Bridge, Ros2Settings

__all__ = [
    "ActionClient",
    "ActionServer",
    "Bridge",
    "Bus",
    "CellNode",
    "Codec",
    "Done",
    "Message",
    "NameMap",
    "Publisher",
    "Reach",
    "Ros1Graph",
    "Ros1Master",
    "Ros1Settings",
    "Ros2Bridge",
    "Ros2Settings",
    "RosTcpClient",
    "RosTcpServer",
    "Schema",
    "ServedCell",
    "ServedPlanner",
    "ServerSettings",
    "ServiceError",
    "State",
    "Subscription",
    "WireError",
    "cdr",
    "schema",
]


def __getattr__(name: str) -> Any:
    """Import node and ROS 2 classes on first access, because they load physics and planners."""
    if name in ("CellNode", "ServedCell", "ServedPlanner"):
        from armcell.ros import nodes

        return getattr(nodes, name)
    if name in ("Reach", "Ros2Bridge", "Ros2Settings"):
        from armcell.ros import ros2

        return getattr(ros2, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
