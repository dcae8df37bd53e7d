"""Cartesian paths: a link follows straight lines, and the result reports the feasible share."""

from armcell.planning.cartesian.plan import plan_cartesian, waypoints_by_offsets

__all__ = ["plan_cartesian", "waypoints_by_offsets"]
