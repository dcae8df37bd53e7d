"""ROS 1 node, master and bus bridge in pure Python; needs no ROS installation.

settings: names and addresses. listener, rpc, header, reactor: socket-level protocols. publication,
subscription, services: TCPROS. registrar, node: a ROS 1 node. master, parameter_tree: the built-in master.
graph_parameters, rosout, bridge, graph: connect an armcell bus to a ROS 1 graph.
"""

from armcell.ros.ros1.graph import Ros1Graph, Ros1Status
from armcell.ros.ros1.master import Ros1Master
from armcell.ros.ros1.node import Ros1Node
from armcell.ros.ros1.settings import Ros1Settings, from_environment

__all__ = ["Ros1Graph", "Ros1Master", "Ros1Node", "Ros1Settings", "Ros1Status", "from_environment"]
