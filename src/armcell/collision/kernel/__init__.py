"""SIMD collision kernel in Numba: sphere covers, 16 configurations at a time, certification."""
