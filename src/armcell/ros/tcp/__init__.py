"""ROS-TCP, the wire of Unity's ROS-TCP-Connector: a server for Unity, and a client in Unity's place.

frames: bytes of a frame. outbox: what waits to be sent. link: one socket with its two threads.
peer: the protocol, the same on both sides. server, client: who registers what.
"""

from armcell.ros.tcp.client import Bridge, RosTcpClient
from armcell.ros.tcp.server import RosTcpServer, ServerSettings

__all__ = ["Bridge", "RosTcpClient", "RosTcpServer", "ServerSettings"]
