"""Search for inverse kinematics solutions by descents from many seeds (Numba)."""

from __future__ import annotations

import numpy as np
from numba import njit

from armcell.kinematics.ik.descent import PATIENCE, descend
from armcell.kinematics.ik.full_turns import nearest_turns
from armcell.kinematics.ik.seeds import rank, take_nearest

DISTINCT = 1e-2  # [rad or m] in any joint


@njit(cache=True, error_model="numpy")
def search(
    table, bounds, turning, goal, scale, reference, seeds, scores, tries, iterations,
    position_tolerance, rotation_tolerance, found, count, want,
):  # fmt: skip
    """Search for distinct IK solutions from many start configurations (seeds), and append up to `want` of
    them to `found` at row `count`.

    Args:
        reference: positions (n,) near which the solutions' full turns are chosen.
        seeds: (s, n) seeds, tried by increasing score; the score of a tried seed becomes infinite.
        tries: maximum number of seeds to try in this call.
    Returns:
        Number of seeds tried, number of solutions in `found`.
    """
    n = len(bounds)
    patience = np.int64(PATIENCE)  # for a literal Numba would compile descend again
    q, axes, J = np.empty(n), np.empty((len(table), 6)), np.empty((n, 7))
    for tried in range(tries):
        if count >= want:
            return tried, count
        seed = take_nearest(scores)
        for c in range(n):
            q[c] = min(max(seeds[seed, c], bounds[c, 0]), bounds[c, 1])
        reached = descend(
            table, bounds, goal, scale, iterations, patience, position_tolerance, rotation_tolerance,
            q, axes, J,
        )[2]  # fmt: skip
        if not reached or nearest_turns(q, reference, bounds, turning) >= 0:
            continue
        new = True
        for other in range(count):
            largest = 0.0
            for c in range(n):
                largest = max(largest, abs(found[other, c] - q[c]))
            new = new and largest > DISTINCT
        if new:
            for c in range(n):
                found[count, c] = q[c]
            count += 1
    return tries, count


@njit(cache=True, error_model="numpy")
def any_solution(
    table, bounds, turning, goal, scale, reference, seeds, poses, tries, iterations,
    position_tolerance, rotation_tolerance, found,
):  # fmt: skip
    """Search for one IK solution from tabulated start configurations (seeds), and write it to `found` (1, n).
    Return whether one was found.
    """
    scores = np.empty(len(seeds), np.float32)
    rank(poses, goal, scale, scores)
    return search(
        table, bounds, turning, goal, scale, reference, seeds, scores, tries, iterations,
        position_tolerance, rotation_tolerance, found, 0, 1,
    )[1] > 0  # fmt: skip
