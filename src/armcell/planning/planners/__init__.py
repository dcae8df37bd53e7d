"""Planners by name. Importing this package registers them."""

from armcell.planning.planners import aorrtc, est, native, ompl, optimisers, prm

__all__ = ["aorrtc", "est", "native", "ompl", "optimisers", "prm"]
