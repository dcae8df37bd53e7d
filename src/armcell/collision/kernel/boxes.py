"""Helpers for walks through bounding-box trees: transforms, and tests of 16 boxes at a time."""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

from armcell._inner_njit import inner_njit
from armcell.collision.kernel.simd import L, fma, load, mask_lt, splat


@inner_njit(forceinline=True)
def to_shape_frame(F, m, cx, cy, cz):
    """Transform points from the world frame to the frame of a world shape, one point per SIMD lane.

    The rows of the transform's 3x4 matrix are stored in F, beginning at F[m].
    """
    x = fma(cx, splat(F[m]), fma(cy, splat(F[m + 1]), fma(cz, splat(F[m + 2]), splat(F[m + 3]))))
    y = fma(cx, splat(F[m + 4]), fma(cy, splat(F[m + 5]), fma(cz, splat(F[m + 6]), splat(F[m + 7]))))
    z = fma(cx, splat(F[m + 8]), fma(cy, splat(F[m + 9]), fma(cz, splat(F[m + 10]), splat(F[m + 11]))))
    return x, y, z


@inner_njit(forceinline=True)
def rotate_to_shape_frame(F, m, cx, cy, cz):
    """Rotate vectors from the world frame to the frame of a world shape, one vector per SIMD lane.

    The rows of the transform's 3x4 matrix are stored in F, beginning at F[m]. Its translation is ignored.
    """
    x = fma(cx, splat(F[m]), fma(cy, splat(F[m + 1]), cz * splat(F[m + 2])))
    y = fma(cx, splat(F[m + 4]), fma(cy, splat(F[m + 5]), cz * splat(F[m + 6])))
    z = fma(cx, splat(F[m + 8]), fma(cy, splat(F[m + 9]), cz * splat(F[m + 10])))
    return x, y, z


@inner_njit(forceinline=True)
def boxes_hit(F, at, lx, ly, lz, hx, hy, hz):
    """Test the 16 bounding boxes that start at F[at] against a given box.
    Return a bit mask of those that overlap it.
    """
    mask = mask_lt(load(F, at), splat(hx)) & mask_lt(load(F, at + L), splat(hy))
    mask &= mask_lt(load(F, at + 2 * L), splat(hz)) & mask_lt(splat(lx), load(F, at + 3 * L))
    return mask & mask_lt(splat(ly), load(F, at + 4 * L)) & mask_lt(splat(lz), load(F, at + 5 * L))
