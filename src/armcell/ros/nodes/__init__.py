"""ROS nodes that serve a cell on the bus, independent of the transport."""

from armcell.ros.nodes.cameras import CameraPublisher
from armcell.ros.nodes.cell_motions import CellMotions
from armcell.ros.nodes.cell_node import CellNode
from armcell.ros.nodes.grasp_server import GraspServer, GraspServerSettings
from armcell.ros.nodes.move_group import MoveGroupNode
from armcell.ros.nodes.pick_place import PickPlaceNode
from armcell.ros.nodes.remote_driver import RemoteDriver
from armcell.ros.nodes.remote_motions import RemoteMotions
from armcell.ros.nodes.served_cell import ServedCell, ServedPlanner
from armcell.ros.nodes.state_publisher import StatePublisher

__all__ = [
    "CameraPublisher",
    "CellMotions",
    "CellNode",
    "GraspServer",
    "GraspServerSettings",
    "MoveGroupNode",
    "PickPlaceNode",
    "RemoteDriver",
    "RemoteMotions",
    "ServedCell",
    "ServedPlanner",
    "StatePublisher",
]
