"""What becomes of lanes that are not free."""

from __future__ import annotations

from armcell._inner_njit import inner_njit
from armcell.collision.kernel.frames import ALIVE, FIRST, PROVE, TOUCHING

FREE, UNPROVEN, CONTACT = 0, 1, 2


@inner_njit
def fail(state, lanes, mode):
    """Note that these lanes are not free; True where nothing is left to find out."""
    state[ALIVE] &= ~lanes
    return mode & PROVE == 0 or state[ALIVE] == 0


@inner_njit
def touch(state, lanes, mode):
    """As `fail`, for lanes that touch for certain."""
    state[TOUCHING] |= lanes
    return fail(state, lanes, mode) or mode & FIRST != 0
