"""Planners by name. Importing this package registers them."""

from armcell.planning.planners import aorrtc, native, ompl, optimisers, prm

__all__ = ["aorrtc", "native", "ompl", "optimisers", "prm"]
