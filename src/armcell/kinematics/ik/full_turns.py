"""Full turns: equivalent joint positions that give the same arm pose, within limits (Numba)."""

from __future__ import annotations

import itertools

import numpy as np
from numba import njit
from numpy.typing import NDArray

from armcell.kinematics.ik.chain import Chain

Array = NDArray[np.float64]

SLACK = 1e-9  # [rad or m] beyond a limit that counts as rounding


@njit(cache=True, error_model="numpy")
def nearest_turns(q, reference, bounds, turning):
    """Rotate the joints of an IK solution q (n,) by full turns, in place, so that the solution is as near as
    possible to the reference.

    All joints end within their bounds.

    Returns:
        -1, or the first joint for which no position is within its bounds.
    """
    turn = 2.0 * np.pi
    outside = -1
    for k in range(len(q)):
        low, high = bounds[k, 0], bounds[k, 1]
        value = q[k]
        if turning[k]:
            value += turn * np.round((reference[k] - value) / turn)
            if value > high + SLACK:
                value -= turn * np.ceil((value - high - SLACK) / turn)
            elif value < low - SLACK:
                value += turn * np.ceil((low - SLACK - value) / turn)
        if outside < 0 and (value > high + SLACK or value < low - SLACK):
            outside = k
        q[k] = min(max(value, low), high) if outside < 0 else value
    return outside


@njit(cache=True, error_model="numpy")
def wrap_and_sort_solutions(found, count, reference, bounds, turning, outside):
    """Rotate the joints of IK solutions (k, n) by full turns into their bounds, and sort the solutions by
    distance from the reference.

    Solutions that do not fit into the bounds are dropped. The nearest to the reference (n,) comes first.

    Args:
        found: solutions, changed in place.
        count: number of rows of `found` that are solutions.
        outside: (n,) counts by joint: incremented for the first joint that excludes a solution.
    Returns:
        Number of solutions left.
    """
    n, kept = len(reference), 0
    squared = np.empty(count)
    row = np.empty(n)
    for i in range(count):
        for k in range(n):
            row[k] = found[i, k]
        joint = nearest_turns(row, reference, bounds, turning)
        if joint >= 0:
            outside[joint] += 1
            continue
        distance = 0.0
        for k in range(n):
            distance += (row[k] - reference[k]) ** 2
        at = kept
        while at > 0 and squared[at - 1] > distance:
            squared[at] = squared[at - 1]
            for k in range(n):
                found[at, k] = found[at - 1, k]
            at -= 1
        squared[at] = distance
        for k in range(n):
            found[at, k] = row[k]
        kept += 1
    return kept


def full_turn_equivalents(q: Array, reference: Array, chain: Chain) -> list[Array]:
    """Return equivalent IK solutions, which differ from `q` by full turns of joints; the one nearest to the
    reference comes first.

    The result contains at most the three nearest positions of each joint within limits, and only the nearest
    position of a joint without limits.

    Args:
        q: positions (n,) within limits.
        reference: positions (n,).
    """
    choices = []
    for value, at, (low, high), turns in zip(q, reference, chain.bounds, chain.turning, strict=True):
        values = [value]
        if turns:
            near = value + 2 * np.pi * (np.round((at - value) / (2 * np.pi)) + np.arange(-3, 4))
            within = near[(near >= low - SLACK) & (near <= high + SLACK)]
            keep = 3 if np.isfinite(low) and np.isfinite(high) else 1
            values = sorted(within, key=lambda v, at=at: abs(v - at))[:keep] or values
        choices.append(np.clip(values, low, high))
    found = [np.array(values) for values in itertools.product(*choices)]
    return sorted(found, key=lambda other: float(np.linalg.norm(other - reference)))
