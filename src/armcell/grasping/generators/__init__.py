"""Generators of grasp candidates, registered by name."""

from armcell.grasping.generators import antipodal, cloud, primitive

__all__ = ["antipodal", "cloud", "primitive"]
