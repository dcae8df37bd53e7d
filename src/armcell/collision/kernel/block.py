"""The question "does it touch?" for sixteen configurations at once.

The hierarchy, outside in: a body's bounding sphere against the boxes of 16 world shapes at a time, the
bounding sphere against the shape, groups of at most 8 spheres, spheres. A sphere's outer radius decides
"certainly free", its inner radius "certainly touching"; what lies between goes to exact convex pieces (gjk),
for just the pair and the lanes in question (undecided).
"""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

import numpy as np
from numba import njit

from armcell.collision.kernel.frames import (
    ALIVE,
    EXACT,
    FIRST,
    NOW,
    PADDED,
    PROVE,
    TOUCHING,
    WAITING,
    fk_block,
    twist_block,
)
from armcell.collision.kernel.pairs import pairs_block
from armcell.collision.kernel.simd import L, pointer
from armcell.collision.kernel.undecided import decide
from armcell.collision.kernel.world import world_block

EVERY = np.int64((1 << L) - 1)  # all lanes


@njit(cache=True)
def check_block(I, F, D, w, state, s, slack, slack_pair, lanes, mode):
    """Which of some lanes (bits) are not free; positions lie at w[j * L:].

    Args:
        slack, slack_pair: [m] per body and per pair of bodies, beside what a proof's intervals need.
        mode: bits. EXACT: decide by exact pieces what the covers cannot, else covers that touch count as
            contact. PADDED: bodies keep their padding from world shapes. PROVE: a lane is free if nothing
            touches in its whole interval (rates and half widths in w), else ask only for the configuration
            itself, and stop at the first that is not free. FIRST: stop at the first certain contact.
    Returns:
        Bits; `state[TOUCHING]` are those of them that certainly touch.
    """
    state[NOW] += 1
    state[ALIVE], state[TOUCHING], state[WAITING] = lanes, 0, 0
    fk_block(I, F, w)
    if mode & PROVE:
        twist_block(I, F, w)
    done = world_block(I, F, D, w, state, s, slack, slack_pair, mode) or pairs_block(
        I, F, D, w, state, s, slack, slack_pair, mode
    )
    if not done and state[WAITING] != 0:
        decide(I, F, D, w, state, s, slack, slack_pair, mode)
    return lanes & ~state[ALIVE]


@njit(cache=True, nogil=True)
def check(I, F, D, w, state, s, slack, slack_pair, mode, q):
    """Whether one configuration (dof,) is not free. On arrays."""
    for j in range(len(q)):
        for lane in range(L):
            w[j * L + lane] = q[j]
    return check_block(
        pointer(I), pointer(F), pointer(D), pointer(w), pointer(state), pointer(s), pointer(slack),
        pointer(slack_pair), np.int64(1), mode,
    ) != 0  # fmt: skip


__all__ = ["EVERY", "EXACT", "FIRST", "PADDED", "PROVE", "check", "check_block"]
