"""The question "does it touch?" for sixteen configurations at once.

The hierarchy, outside in: a body's bounding sphere against the boxes of 16 world shapes at a time, the
bounding sphere against the shape, groups of at most 8 spheres, spheres. A sphere's outer radius decides
"certainly free", its inner radius "certainly touching"; what lies between goes to exact convex pieces (gjk),
for just the pair and the lanes in question (undecided).
"""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numba import cfunc, njit, types

from armcell._inner_njit import inner_njit
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
from armcell.collision.kernel.simd import L, at_address, call, pointer
from armcell.collision.kernel.undecided import decide
from armcell.collision.kernel.world import world_block

EVERY = np.int64((1 << L) - 1)  # all lanes

# What a handle holds.
AT_I, AT_F, AT_D, AT_W, AT_STATE, AT_S, AT_SLACK, AT_SLACK_PAIR, AT_CHECK, AT_SELF = range(10)


@inner_njit
def _check_arrays(I, F, D, w, state, s, slack, slack_pair, lanes, mode):
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


def _check(handle, lanes, mode):
    k = at_address(np.int64, handle)
    return _check_arrays(
        at_address(np.int32, k[AT_I]), at_address(np.float32, k[AT_F]), at_address(np.float64, k[AT_D]),
        at_address(np.float32, k[AT_W]), at_address(np.int64, k[AT_STATE]), at_address(np.float64, k[AT_S]),
        at_address(np.float32, k[AT_SLACK]), at_address(np.float32, k[AT_SLACK_PAIR]), lanes, mode,
    )  # fmt: skip


@lru_cache(maxsize=1)
def check_address() -> int:
    """Where `_check_arrays` lies in memory as a C function of a handle's address, lanes and mode.

    Everything that asks calls this one: Numba would compile a copy into each, and take minutes.
    """
    return int(cfunc(types.int64(types.int64, types.int64, types.int64), cache=True)(_check).address or 0)


@lru_cache(maxsize=1)
def free_check_address() -> int:
    """The address of a check that finds every lane free: it lets the check's callers compile without it."""
    return int(cfunc(types.int64(types.int64, types.int64, types.int64))(_free_check).address or 0)


def _free_check(handle, lanes, mode):
    return 0


def handle_of(arrays: Sequence[np.ndarray]) -> np.ndarray:
    """The addresses of the pack (I, F, D), the workspace (w, state, s), slack and slack_pair, and of `check`.

    One argument instead of nine: Python takes half a microsecond for each. Keep the arrays as long as it.
    """
    handle = np.zeros(10, np.int64)
    handle[:8] = [array.ctypes.data for array in arrays]
    handle[AT_CHECK] = check_address()
    handle[AT_SELF] = handle.ctypes.data
    return handle


@inner_njit(forceinline=True)
def check_block(k, lanes, mode):
    """`_check_arrays` by handle."""
    return call(k[AT_CHECK], k[AT_SELF], lanes, mode)


@inner_njit(forceinline=True)
def ints(k):
    """The integers of the pack, I."""
    return at_address(np.int32, k[AT_I])


@inner_njit(forceinline=True)
def lanes_of(k):
    """The lanes' workspace, w."""
    return at_address(np.float32, k[AT_W])


@njit(cache=True, nogil=True)
def touches(handle, mode, q):
    """Whether one configuration (dof,) is not free. On arrays."""
    k = pointer(handle)
    w = lanes_of(k)
    for j in range(len(q)):
        for lane in range(L):
            w[j * L + lane] = q[j]
    return check_block(k, np.int64(1), np.int64(mode)) != 0


__all__ = ["EVERY", "EXACT", "FIRST", "PADDED", "PROVE", "check_block", "handle_of", "touches"]
