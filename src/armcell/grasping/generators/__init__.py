"""Generators of grasp candidates, registered by name."""

from armcell.grasping.generators import antipodal, cloud, primitive, suction

__all__ = ["antipodal", "cloud", "primitive", "suction"]
