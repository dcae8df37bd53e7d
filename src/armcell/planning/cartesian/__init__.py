"""Cartesian paths: a link follows straight lines; reports the feasible fraction."""

from armcell.planning.cartesian.plan import plan_cartesian, waypoints_by_offsets

__all__ = ["plan_cartesian", "waypoints_by_offsets"]
