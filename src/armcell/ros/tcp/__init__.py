"""ROS-TCP, the protocol of Unity's ROS-TCP-Connector: a server for Unity, and a client.

The client takes Unity's role at any ROS-TCP endpoint. frames: encoding of frames. outbox: send queues.
link: one socket with its two threads. peer: the protocol, common to both sides. server, client: the sides
that register topics and services.
"""

from armcell.ros.tcp.client import ForwardedNames, RosTcpClient
from armcell.ros.tcp.server import RosTcpServer, ServerSettings

__all__ = ["ForwardedNames", "RosTcpClient", "RosTcpServer", "ServerSettings"]
