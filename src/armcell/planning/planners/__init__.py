"""Planners by name. Importing this package registers them."""

from armcell.planning.planners import native, ompl

__all__ = ["native", "ompl"]
