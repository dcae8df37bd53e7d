"""Messages, the in-process bus and the wires (Unity; later ROS 1, ROS 2), with nothing of ROS installed."""

from typing import TYPE_CHECKING, Any

from armcell.ros.actions import ActionClient, ActionServer, Done, State
from armcell.ros.bus import Bus, Publisher, ServiceError, Subscription
from armcell.ros.codec import Codec, WireError, cdr, ros1
from armcell.ros.messages import Message
from armcell.ros.schema import Schema, schema
from armcell.ros.tcp import Bridge, RosTcpClient, RosTcpServer, ServerSettings

if TYPE_CHECKING:
    from armcell.ros.nodes import CellNode

__all__ = [
    "ActionClient",
    "ActionServer",
    "Bridge",
    "Bus",
    "CellNode",
    "Codec",
    "Done",
    "Message",
    "Publisher",
    "RosTcpClient",
    "RosTcpServer",
    "Schema",
    "ServerSettings",
    "ServiceError",
    "State",
    "Subscription",
    "WireError",
    "cdr",
    "ros1",
    "schema",
]


def __getattr__(name: str) -> Any:
    """CellNode brings physics and planners along: only for those who ask for it."""
    if name == "CellNode":
        from armcell.ros.nodes import CellNode

        return CellNode
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
