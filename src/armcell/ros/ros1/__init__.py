"""ROS 1 with none of it installed: a node, a master, and a bus joined to a graph.

settings: names and addresses. listener, rpc, header, reactor: what goes over sockets. publication,
subscription, services: TCPROS. registrar, node: a node of the graph. master, parameter_tree: our own master.
graph_names, graph_parameters, rosout, bridge, graph: a bus in the graph.
"""

from armcell.ros.ros1.graph import Ros1Graph, Ros1Status
from armcell.ros.ros1.master import Ros1Master
from armcell.ros.ros1.node import Ros1Node
from armcell.ros.ros1.settings import Ros1Settings, from_environment

__all__ = ["Ros1Graph", "Ros1Master", "Ros1Node", "Ros1Settings", "Ros1Status", "from_environment"]
