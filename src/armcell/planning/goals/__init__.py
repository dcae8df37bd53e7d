"""Conversion of a planning request's goals to joint positions.

The package contains user targets, inverse kinematics and the sampling of goal regions.
"""
