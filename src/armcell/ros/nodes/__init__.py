"""What is served on the bus, written once for every wire."""

from armcell.ros.nodes.cameras import CameraPublisher
from armcell.ros.nodes.cell_node import CellNode
from armcell.ros.nodes.states import StatePublisher

__all__ = ["CameraPublisher", "CellNode", "StatePublisher"]
