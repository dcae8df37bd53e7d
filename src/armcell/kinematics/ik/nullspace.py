"""Null-space motion of redundant arms: change an IK solution without moving the tip (Numba)."""

from __future__ import annotations

import numpy as np
from numba import njit

from armcell.kinematics.ik.chain import FAST, tip_pose
from armcell.kinematics.ik.descent import BIAS, LARGEST_STEP, PATIENCE, damped_step, descend, jacobian

STEPS, CORRECTIONS = 30, 8  # slides, and iterations of the descent back to the goal after each
ENOUGH = 1e-3  # [rad or m] sliding ends when the possible gain is smaller


@njit(cache=True, fastmath=FAST, error_model="numpy")
def approach_in_null_space(table, bounds, goal, scale, reference, position_tolerance, rotation_tolerance, q):
    """Move an IK solution q (n,) closer to a reference (n,) within its null space. The tip keeps its pose,
    and the joints stay within their bounds.

    Each step goes toward the reference without the component that would move the tip; then a descent brings
    the tip back to its goal. The step size is halved, down to a sixteenth, after steps without progress.
    """
    n = len(q)
    axes, J = np.empty((len(table), 6)), np.empty((n, 7))
    T, e, A = np.empty(12), np.empty(6), np.empty((6, 6))
    corrections, patience = np.int64(CORRECTIONS), np.int64(PATIENCE)  # for literals Numba compiles again
    trial, factor = np.empty(n), 1.0
    distance = 0.0
    for c in range(n):
        distance += (reference[c] - q[c]) ** 2
    for _ in range(STEPS):
        tip_pose(table, q, axes, T)
        jacobian(table, axes, T, scale, J)
        for r in range(6):
            e[r] = 0.0
            for c in range(n):
                e[r] += J[c, r] * (reference[c] - q[c])
        damped_step(J, n, e, BIAS, A)
        largest = 0.0
        for c in range(n):
            largest = max(largest, abs(reference[c] - q[c] - J[c, 6]))
        if largest < ENOUGH:
            return
        length = factor * min(1.0, LARGEST_STEP / largest)
        nearer = 0.0
        for c in range(n):
            step = length * (reference[c] - q[c] - J[c, 6])
            trial[c] = min(max(q[c] + step, bounds[c, 0]), bounds[c, 1])
        reached = descend(
            table, bounds, goal, scale, corrections, patience, position_tolerance, rotation_tolerance,
            trial, axes, J,
        )[2]  # fmt: skip
        for c in range(n):
            nearer += (reference[c] - trial[c]) ** 2
        if reached and nearer < distance:
            for c in range(n):
                q[c] = trial[c]
            if distance - nearer < ENOUGH * ENOUGH:
                return
            distance = nearer
            factor = min(1.0, 2.0 * factor)
        elif factor > 0.1:
            factor *= 0.5
        else:
            return


@njit(cache=True, fastmath=FAST, error_model="numpy")
def null_space_step(table, bounds, goal, scale, wish, iterations, position_tolerance, rotation_tolerance, q):
    """Move an IK solution q (n,) by the null-space part of the desired joint step `wish` (n,),
    then bring the tip back to its goal.

    q changes in place.

    Returns:
        Whether the tip reaches the goal within bounds; otherwise q is unchanged.
    """
    n = len(q)
    axes, J = np.empty((len(table), 6)), np.empty((n, 7))
    T, e, A = np.empty(12), np.empty(6), np.empty((6, 6))
    trial = np.empty(n)
    tip_pose(table, q, axes, T)
    jacobian(table, axes, T, scale, J)
    for r in range(6):
        e[r] = 0.0
        for c in range(n):
            e[r] += J[c, r] * wish[c]
    damped_step(J, n, e, BIAS, A)
    for c in range(n):
        trial[c] = min(max(q[c] + wish[c] - J[c, 6], bounds[c, 0]), bounds[c, 1])
    reached = descend(
        table, bounds, goal, scale, iterations, iterations, position_tolerance, rotation_tolerance,
        trial, axes, J,
    )[2]  # fmt: skip
    if reached:
        for c in range(n):
            q[c] = trial[c]
    return reached
