"""The SIMD kernel: sphere covers, blocks of 16 configurations, certified motions, in Numba."""
