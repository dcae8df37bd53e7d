"""Compiled kernels of the native planners (Numba).

Searches, trees, nearest neighbors, path simplification.
"""
