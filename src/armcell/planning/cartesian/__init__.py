"""Straight lines of a link, step by step: how far they come, and why not farther."""

from armcell.planning.cartesian.plan import plan_cartesian
from armcell.planning.cartesian.poses import waypoints_by_offsets

__all__ = ["plan_cartesian", "waypoints_by_offsets"]
