"""ROS messages, an in-process bus, and transports to Unity, ROS 1 and ROS 2.

The package needs no ROS installation.
"""

from typing import TYPE_CHECKING, Any

from armcell.ros.actions import ActionClient, ActionOutcome, ActionServer, GoalState
from armcell.ros.bus import Bus, Publisher, ServiceError, Subscription
from armcell.ros.codec import Codec, WireError, cdr_codec
from armcell.ros.names import NameMap
from armcell.ros.ros1 import Ros1Graph, Ros1Master, Ros1Settings
from armcell.ros.schema import Message, Schema, schema
from armcell.ros.tcp import ForwardedNames, RosTcpClient, RosTcpServer, ServerSettings

if TYPE_CHECKING:
    from armcell.ros.nodes import CellNode, ServedCell, ServedPlanner
    from armcell.ros.ros2 import DomainScope, Ros2Bridge, Ros2Settings

__all__ = [
    "ActionClient",
    "ActionOutcome",
    "ActionServer",
    "Bus",
    "CellNode",
    "Codec",
    "DomainScope",
    "ForwardedNames",
    "GoalState",
    "Message",
    "NameMap",
    "Publisher",
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
    "Subscription",
    "WireError",
    "cdr_codec",
    "schema",
]


def __getattr__(name: str) -> Any:
    """Import node and ROS 2 classes on first access, because they load physics and planners."""
    if name in ("CellNode", "ServedCell", "ServedPlanner"):
        from armcell.ros import nodes

        return getattr(nodes, name)
    if name in ("DomainScope", "Ros2Bridge", "Ros2Settings"):
        from armcell.ros import ros2

        return getattr(ros2, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
