"""Damped least squares from one seed, and null-space motion of redundant arms (Numba).

The descent is the inner loop of numeric inverse kinematics; the null-space motion changes a solution
without moving the tip. The damping follows Sugihara, "Solvability-unconcerned inverse kinematics by the
Levenberg-Marquardt method" (IEEE T-RO 2011): proportional to the squared error plus a small bias. If a
step would push a joint beyond its limit, the step is solved again without this joint: a Panda then
needs 1.4 seeds per pose instead of 2.0 (mean of 1000 poses).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from armcell.kinematics.ik.chain import COLUMN, FAST, MULTIPLIER, SLIDE, pose_error, tip_pose

DAMPING, BIAS = 0.1, 1e-8
LARGEST_STEP = 0.5  # [rad or m] of any joint in one iteration
PROGRESS, PATIENCE = 0.8, 3  # give up after PATIENCE iterations that leave over PROGRESS of the error
RELEASES = 3  # solves per iteration: the first with all joints, more without joints at a limit
ENOUGH = 1e-3  # [rad or m] sliding ends when the possible gain is smaller


@njit(cache=True, fastmath=FAST, error_model="numpy")
def damped_step(J, n, e, damping, A):
    """Compute one damped least-squares step of an IK descent, `J^T (J J^T + damping)^-1 e`, and write the
    joint step to the spare column J[:, 6].

    J (n, 7) has a row per joint, A (6, 6) is scratch.
    """
    for i in range(6):
        for j in range(i + 1):
            s = damping if i == j else 0.0
            for c in range(n):
                s += J[c, i] * J[c, j]
            A[i, j] = s
    for j in range(6):  # L D L^T
        d = A[j, j]
        for k in range(j):
            d -= A[j, k] * A[j, k] * A[k, k]
        A[j, j] = d
        for i in range(j + 1, 6):
            s = A[i, j]
            for k in range(j):
                s -= A[i, k] * A[j, k] * A[k, k]
            A[i, j] = s / d
    y0 = e[0]
    y1 = e[1] - A[1, 0] * y0
    y2 = e[2] - A[2, 0] * y0 - A[2, 1] * y1
    y3 = e[3] - A[3, 0] * y0 - A[3, 1] * y1 - A[3, 2] * y2
    y4 = e[4] - A[4, 0] * y0 - A[4, 1] * y1 - A[4, 2] * y2 - A[4, 3] * y3
    y5 = e[5] - A[5, 0] * y0 - A[5, 1] * y1 - A[5, 2] * y2 - A[5, 3] * y3 - A[5, 4] * y4
    y5 = y5 / A[5, 5]
    y4 = y4 / A[4, 4] - A[5, 4] * y5
    y3 = y3 / A[3, 3] - A[4, 3] * y4 - A[5, 3] * y5
    y2 = y2 / A[2, 2] - A[3, 2] * y3 - A[4, 2] * y4 - A[5, 2] * y5
    y1 = y1 / A[1, 1] - A[2, 1] * y2 - A[3, 1] * y3 - A[4, 1] * y4 - A[5, 1] * y5
    y0 = y0 / A[0, 0] - A[1, 0] * y1 - A[2, 0] * y2 - A[3, 0] * y3 - A[4, 0] * y4 - A[5, 0] * y5
    for c in range(n):
        J[c, 6] = J[c, 0] * y0 + J[c, 1] * y1 + J[c, 2] * y2 + J[c, 3] * y3 + J[c, 4] * y4 + J[c, 5] * y5


@njit(cache=True, fastmath=FAST, error_model="numpy")
def jacobian(table, axes, T, scale, J):
    """Compute the Jacobian of the tip for a numeric IK descent and write it to J[:, :6], one row per joint.

    A row contains the tip's velocity times `scale`, then its angular velocity.

    Args:
        axes, T: from `tip_pose`.
    """
    J[:] = 0.0
    for k in range(len(table)):
        c, m = int(table[k, COLUMN]), table[k, MULTIPLIER]
        wx, wy, wz = axes[k, 0] * m, axes[k, 1] * m, axes[k, 2] * m
        if table[k, SLIDE] != 0.0:
            J[c, 0] += scale * wx
            J[c, 1] += scale * wy
            J[c, 2] += scale * wz
        else:
            dx, dy, dz = T[3] - axes[k, 3], T[7] - axes[k, 4], T[11] - axes[k, 5]
            J[c, 0] += scale * (wy * dz - wz * dy)
            J[c, 1] += scale * (wz * dx - wx * dz)
            J[c, 2] += scale * (wx * dy - wy * dx)
            J[c, 3] += wx
            J[c, 4] += wy
            J[c, 5] += wz


@njit(cache=True, fastmath=FAST, error_model="numpy")
def descend(
    table, bounds, goal, scale, iterations, patience, position_tolerance, rotation_tolerance, q, axes, J
):  # fmt: skip
    """Reduce the pose error of an IK solution q (n,) in place by damped least squares (descent), within the
    joint bounds.

    Args:
        scale: weight of a meter against a radian [1/m].
        patience: iterations without progress before the descent gives up.
        axes, J: scratch (m, 6) and (n, 7).
    Returns:
        Position error [m], rotation error [rad], whether both are within tolerance, iterations.
    """
    n = len(q)
    T, e, A = np.empty(12), np.empty(6), np.empty((6, 6))
    position, angle, previous, stalled = 0.0, 0.0, np.inf, 0
    for iteration in range(iterations):
        tip_pose(table, q, axes, T)
        position, angle = pose_error(T, goal, e)
        if position <= position_tolerance and angle <= rotation_tolerance:
            return position, angle, True, iteration + 1
        cost = scale * scale * position * position + angle * angle
        stalled = stalled + 1 if cost > PROGRESS * previous else 0
        previous = cost
        if stalled >= patience:
            return position, angle, False, iteration + 1
        jacobian(table, axes, T, scale, J)
        e[0] *= scale
        e[1] *= scale
        e[2] *= scale
        for _ in range(RELEASES):
            damped_step(J, n, e, DAMPING * cost + BIAS, A)
            pressing = False
            for c in range(n):
                step = J[c, 6]
                if (step > 0.0 and q[c] >= bounds[c, 1]) or (step < 0.0 and q[c] <= bounds[c, 0]):
                    pressing = True
                    for r in range(6):
                        J[c, r] = 0.0
            if not pressing:
                break
        largest = 0.0
        for c in range(n):
            largest = max(largest, abs(J[c, 6]))
        factor = 1.0 if largest < LARGEST_STEP else LARGEST_STEP / largest
        for c in range(n):
            q[c] = min(max(q[c] + factor * J[c, 6], bounds[c, 0]), bounds[c, 1])
    tip_pose(table, q, axes, T)
    position, angle = pose_error(T, goal, e)
    reached = position <= position_tolerance and angle <= rotation_tolerance
    return position, angle, reached, iterations


STEPS, CORRECTIONS = 30, 8  # slides, and iterations of the descent back to the goal after each


@njit(cache=True, fastmath=FAST, error_model="numpy")
def approach_in_null_space(table, bounds, goal, scale, reference, position_tolerance, rotation_tolerance, q):
    """Move an IK solution q (n,) closer to a reference (n,) by a descent within its null space. The tip keeps
    its pose, and the joints stay within their bounds.

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
    """Move a redundant arm's IK solution q (n,) by the null-space component of the desired joint step `wish`
    (n,), then correct q by a descent so that the tip is at its goal again.

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
