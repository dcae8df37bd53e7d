"""Import of Gazebo's SDF worlds and models as objects of a planning scene."""

from armcell.scene.sdf.elements import SkippedElement
from armcell.scene.sdf.world import SdfWorld, load_sdf

__all__ = ["SdfWorld", "SkippedElement", "load_sdf"]
