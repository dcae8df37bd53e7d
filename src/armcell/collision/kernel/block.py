"""Collision check of 16 configurations at once in the SIMD kernel, coarse tests first.

The tests, from coarse to fine: a body's bounding sphere against the bounding boxes of 16 world shapes at a
time, the bounding sphere against the shape, groups of at most 8 spheres, single spheres. If a sphere's outer
radius is clear, the body is certainly free; if its inner radius touches, the body is certainly in contact.
Undecided cases go to the exact convex pieces (`gjk`), only for the pair and the lanes concerned
(`undecided`).
"""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numba import cfunc, njit, types

from armcell._inner_njit import inner_njit
from armcell.collision.kernel.exact_checks import run_exact_tests
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
from armcell.collision.kernel.world_collision import world_block

EVERY = np.int64((1 << L) - 1)  # all lanes

# Indices of the addresses in a handle.
AT_I, AT_F, AT_D, AT_W, AT_STATE, AT_S, AT_SLACK, AT_SLACK_PAIR, AT_CHECK, AT_SELF = range(10)


@inner_njit
def _check_arrays(I, F, D, w, state, s, slack, slack_pair, lanes, mode):
    """Check a block of 16 configurations (one per SIMD lane).
    Return a bit mask of those that are not collision-free.

    The positions of joint j are at w[j * L:], one per lane.

    Args:
        slack, slack_pair: [m] margin per body and per pair of bodies, in addition to the margin that a
            proof's intervals need.
        mode: bits. EXACT: use exact pieces where the sphere covers cannot decide; without it, touching covers
            count as contact. PADDED: bodies keep their padding from world shapes. PROVE: a lane is free if
            nothing touches in its whole interval (rates and half widths in w); without it, only the
            configuration itself is checked, and the check stops at the first lane that is not free. FIRST:
            stop at the first certain contact.
    Returns:
        Bits of the lanes that are not free; `state[TOUCHING]` has the bits of lanes that certainly touch.
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
        run_exact_tests(I, F, D, w, state, s, slack, slack_pair, mode)
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
    """Return the memory address of the compiled function that checks a block of 16 configurations.

    The function takes the address of a handle, the lanes and the mode. All callers call the function by this
    address. Otherwise, Numba would compile a copy into each caller, which takes minutes.
    """
    return int(cfunc(types.int64(types.int64, types.int64, types.int64), cache=True)(_check).address or 0)


@lru_cache(maxsize=1)
def free_check_address() -> int:
    """Return the memory address of a stub for the compiled collision check.
    The stub always reports no collision, and code that calls the stub compiles quickly.
    """
    return int(cfunc(types.int64(types.int64, types.int64, types.int64))(_free_check).address or 0)


def _free_check(handle, lanes, mode):
    return 0


def handle_of(arrays: Sequence[np.ndarray]) -> np.ndarray:
    """Return the handle of a collision check: an array of memory addresses for compiled code.
    The handle contains the addresses of the kernel arrays and of the compiled check function.

    The arrays are the pack (I, F, D), the workspace (w, state, s), slack and slack_pair. The handle replaces
    nine arguments, each of which costs half a microsecond in a call from Python. Keep the arrays alive as
    long as the handle.
    """
    handle = np.zeros(10, np.int64)
    handle[:8] = [array.ctypes.data for array in arrays]
    handle[AT_CHECK] = check_address()
    handle[AT_SELF] = handle.ctypes.data
    return handle


@inner_njit(forceinline=True)
def check_block(k, lanes, mode):
    """Check a block of 16 configurations for collisions in one call, given a handle to the kernel's data."""
    return call(k[AT_CHECK], k[AT_SELF], lanes, mode)


@inner_njit(forceinline=True)
def ints(k):
    """Return a pointer to the integer array of the collision kernel,
    given the handle to the kernel's data.
    """
    return at_address(np.int32, k[AT_I])


@inner_njit(forceinline=True)
def lanes_of(k):
    """Return a pointer to the workspace for the SIMD lanes,
    given the handle to the collision kernel's data.
    """
    return at_address(np.float32, k[AT_W])


@njit(cache=True, nogil=True)
def touches(handle, mode, q):
    """Return whether a block check of the SIMD kernel reports a single configuration q (dof,) as not
    collision-free.

    Python code can call this function. The function copies q to all SIMD lanes before the check.
    """
    k = pointer(handle)
    w = lanes_of(k)
    for j in range(len(q)):
        for lane in range(L):
            w[j * L + lane] = q[j]
    return check_block(k, np.int64(1), np.int64(mode)) != 0


__all__ = ["EVERY", "EXACT", "FIRST", "PADDED", "PROVE", "check_block", "handle_of", "touches"]
