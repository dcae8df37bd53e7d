"""Bookkeeping of lanes that a collision check has found not free or in contact."""

from __future__ import annotations

from armcell._inner_njit import inner_njit
from armcell.collision.kernel.frames import ALIVE, FIRST, PROVE, TOUCHING

FREE, UNPROVEN, CONTACT = 0, 1, 2


@inner_njit
def fail(state, lanes, mode):
    """Mark lanes as not free; return True if no lane is left to check."""
    state[ALIVE] &= ~lanes
    return mode & PROVE == 0 or state[ALIVE] == 0


@inner_njit
def touch(state, lanes, mode):
    """Mark lanes as certainly in contact; return True if the check can stop."""
    state[TOUCHING] |= lanes
    return fail(state, lanes, mode) or mode & FIRST != 0
