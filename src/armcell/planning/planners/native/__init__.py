"""Compiled kernels of the native planners (Numba).

The kernels are searches, trees, nearest neighbors and path simplification.
"""
