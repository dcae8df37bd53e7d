"""Bookkeeping of the SIMD lanes (configurations) that a collision check finds not free."""

from __future__ import annotations

from armcell._inner_njit import inner_njit
from armcell.collision.kernel.frames import ALIVE, FIRST, PROVE, TOUCHING

FREE, UNPROVEN, CONTACT = 0, 1, 2


@inner_njit
def record_collision(state, lanes, mode):
    """Record that the configurations in some SIMD lanes are not collision-free.
    Return True if the collision check can stop early.
    """
    state[ALIVE] &= ~lanes
    return mode & PROVE == 0 or state[ALIVE] == 0


@inner_njit
def record_contact(state, lanes, mode):
    """Record that the configurations in some SIMD lanes are in contact.
    Return True if the collision check can stop early.
    """
    state[TOUCHING] |= lanes
    return record_collision(state, lanes, mode) or mode & FIRST != 0
