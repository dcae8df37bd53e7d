"""Planners by name. Importing this package registers them."""

from armcell.planning.planners import ompl

__all__ = ["ompl"]
