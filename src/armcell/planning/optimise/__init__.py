"""Trajectory optimisation: a whole path pushed out of obstacles by their signed distances."""
