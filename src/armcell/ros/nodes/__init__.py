"""ROS nodes that serve a cell on the bus, independent of the transport."""

from armcell.ros.nodes.access import CellAccess
from armcell.ros.nodes.cameras import CameraPublisher
from armcell.ros.nodes.cell_node import CellNode
from armcell.ros.nodes.grasp_server import GraspServer, GraspServerSettings
from armcell.ros.nodes.local_cell import LocalCell
from armcell.ros.nodes.move_group import MoveGroupNode
from armcell.ros.nodes.pick_place import PickPlaceNode
from armcell.ros.nodes.remote_cell import RemoteCell
from armcell.ros.nodes.served import ServedCell, ServedPlanner
from armcell.ros.nodes.states import StatePublisher

__all__ = [
    "CameraPublisher",
    "CellAccess",
    "CellNode",
    "GraspServer",
    "GraspServerSettings",
    "LocalCell",
    "MoveGroupNode",
    "PickPlaceNode",
    "RemoteCell",
    "ServedCell",
    "ServedPlanner",
    "StatePublisher",
]
