"""Proof that the bodies of a robot keep a distance from each other along a motion."""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

import numpy as np
from numba import njit

from armcell.collision.kernel import gjk
from armcell.collision.kernel.block import AT_S, AT_SLACK_PAIR, FIRST, ints
from armcell.collision.kernel.layout import PAIRS
from armcell.collision.kernel.motion import FINEST, PROVEN, deviation_margins, prove
from armcell.collision.kernel.simd import at_address, pointer


@njit(cache=True, nogil=True)
def first_below_clearance(handle, points, room, distance):
    """Return the first position along a motion (k, dof) at which the clearance proof for two bodies of the
    robot fails.

    Args:
        room: (dof,) largest deviation of each joint from the edges [rad or m].
        distance: clearance between two bodies [m].
    Returns:
        The position counted in edges, or -1.0 if the clearance is proven on the whole motion.
    """
    k, (n, dof) = pointer(handle), points.shape
    I, s = ints(k), at_address(np.float64, k[AT_S])
    slack_pair = at_address(np.float32, k[AT_SLACK_PAIR])
    rows, at = np.arange(n) * dof, np.empty(n)  # used after the call, to stay alive
    deviation_margins(k, pointer(room))
    for b in range(I[PAIRS]):
        slack_pair[b] += np.float32(distance)
    s[gjk.CLOSE] = distance
    prove(
        k, pointer(points), pointer(rows), pointer(rows[1:]), n - 1, pointer(at), np.int64(FIRST), FINEST
    )  # fmt: skip
    s[gjk.CLOSE] = 0.0
    for e in range(n - 1):
        if at[e] != PROVEN:
            return rows[e] / dof + at[e]
    return -1.0
