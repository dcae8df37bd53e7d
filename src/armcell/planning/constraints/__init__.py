"""Constraints on joints, positions, orientations and visibility.

The package evaluates constraints, plans on the constraint manifold and proves motions.
"""
