"""Projection of a configuration onto its constraints (Numba).

The method is damped Gauss-Newton on the violated tolerances, with the damping of the inverse kinematics
(Sugihara 2011, see kinematics.ik.descent).
"""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

import numpy as np
from numba import njit

from armcell.collision.kernel.simd import pointer
from armcell.kinematics.ik.chain import COLUMN, MULTIPLIER, SLIDE, WIDTH
from armcell.planning.constraints.error_kernels import (
    AT_LINKS,
    AT_POINTS,
    AT_SHAPES,
    AT_TURNS,
    BALL,
    BOX,
    CAPSULE,
    CYLINDER,
    DOF,
    FULL,
    INNER,
    INNER_SIZE,
    JOINTS,
    LINK_WIDTH,
    MAX_ROWS,
    NUMBERS,
    PLACE,
    POINT_WIDTH,
    POINTS,
    SHAPE_WIDTH,
    SIZE,
    TABLE,
    TURN_WIDTH,
    TURNS,
    WORK,
    manifold_pointers,
    nearest_region_shape,
    orientation_error,
    place_links,
    point_at,
)

ITERATIONS = 24
LARGEST_STEP = 0.6  # [rad or m] of any joint in one iteration
DAMPING, BIAS = 0.05, 1e-9
BEYOND = 0.3  # aim inside by this share of the gap between planning tolerances and full tolerances
PROGRESS, PATIENCE = 0.8, 3  # give up after PATIENCE iterations that leave over PROGRESS of the error


@njit(cache=True)
def _row(n, c, x, link, row, gx, gy, gz, turns, px, py, pz):
    """Write one Jacobian row for projection onto constraints. For each joint, the row contains the rate at
    which the link's point (px, py, pz) moves along the direction g, or at which the link rotates about g.

    If `turns` is true, the row contains the angular velocities.
    """
    dof, at = n[DOF], n[WORK] + 32 + row * n[DOF]
    for j in range(dof):
        x[at + j] = 0.0
    l = n[AT_LINKS] + link * LINK_WIDTH
    t, o = n[l + TABLE], n[l + PLACE] + 12
    for _ in range(n[l + JOINTS]):
        ax, ay, az = x[o], x[o + 1], x[o + 2]
        if turns:
            rate = gx * ax + gy * ay + gz * az if c[t + SLIDE] == 0.0 else 0.0
        elif c[t + SLIDE] != 0.0:
            rate = gx * ax + gy * ay + gz * az
        else:
            dx, dy, dz = px - x[o + 3], py - x[o + 4], pz - x[o + 5]
            rate = gx * (ay * dz - az * dy) + gy * (az * dx - ax * dz) + gz * (ax * dy - ay * dx)
        x[at + int(c[t + COLUMN])] += c[t + MULTIPLIER] * rate
        t += WIDTH
        o += 6


@njit(cache=True)
def _local_row(n, c, x, point, s, row, ga, gb, gd, excess, px, py, pz):
    """Write the Jacobian row and the residual for moving a constrained point back into its region. The
    direction (ga, gb, gd) points out of the region, in the frame of the region's shape.
    """
    at = n[s + 1]
    link = n[n[AT_POINTS] + point * POINT_WIDTH]
    _row(
        n, c, x, link, row,
        ga * c[at] + gb * c[at + 4] + gd * c[at + 8],
        ga * c[at + 1] + gb * c[at + 5] + gd * c[at + 9],
        ga * c[at + 2] + gb * c[at + 6] + gd * c[at + 10], False, px, py, pz,
    )  # fmt: skip
    x[n[WORK] + 32 + MAX_ROWS * n[DOF] + row] = excess


@njit(cache=True)
def _axis(n, c, x, point, s, row, value, axis, full, inner, px, py, pz):
    """Write the Jacobian row and the residual for moving a constrained point back into its region along one
    axis of the region's shape. Write nothing if the point is already inside on this axis.

    The point is outside if its coordinate `value` [m] exceeds `inner` [m] in magnitude. The projection moves
    the point back along the axis.

    Return the row count.
    """
    if abs(value) <= inner:
        return row
    sign = 1.0 if value > 0.0 else -1.0
    _local_row(
        n, c, x, point, s, row,
        sign if axis == 0 else 0.0, sign if axis == 1 else 0.0, sign if axis == 2 else 0.0,
        abs(value) - inner + BEYOND * (full - inner), px, py, pz,
    )  # fmt: skip
    return row + 1


@njit(cache=True)
def rows(n, c, x):
    """Write the Jacobian rows and residuals with which joint positions are projected onto all violated
    constraints.

    Return the row count.
    """
    count, residual = 0, n[WORK] + 32 + MAX_ROWS * n[DOF]
    for turn in range(n[TURNS]):
        orientation_error(n, c, x, turn)
        t, e = n[AT_TURNS] + turn * TURN_WIDTH, n[WORK]
        for i in range(3):
            full, inner = c[n[t + NUMBERS] + FULL + i], c[n[t + NUMBERS] + INNER + i]
            if abs(x[e + i]) <= inner:
                continue
            sign, g = 1.0 if x[e + i] > 0.0 else -1.0, e + 3 + 3 * i
            _row(n, c, x, n[t], count, sign * x[g], sign * x[g + 1], sign * x[g + 2], True, 0.0, 0.0, 0.0)
            x[residual + count] = abs(x[e + i]) - inner + BEYOND * (full - inner)
            count += 1
    for point in range(n[POINTS]):
        px, py, pz = point_at(n, c, x, point)
        shape, far = nearest_region_shape(n, c, point, INNER_SIZE, px, py, pz)
        if far <= 0.0:
            continue
        s = n[AT_SHAPES] + shape * SHAPE_WIDTH
        kind, at = n[s], n[s + 1]
        a = c[at] * px + c[at + 1] * py + c[at + 2] * pz + c[at + 3]
        b = c[at + 4] * px + c[at + 5] * py + c[at + 6] * pz + c[at + 7]
        d = c[at + 8] * px + c[at + 9] * py + c[at + 10] * pz + c[at + 11]
        f, i = at + SIZE, at + INNER_SIZE
        if kind == BOX:
            count = _axis(n, c, x, point, s, count, a, 0, c[f], c[i], px, py, pz)
            count = _axis(n, c, x, point, s, count, b, 1, c[f + 1], c[i + 1], px, py, pz)
            count = _axis(n, c, x, point, s, count, d, 2, c[f + 2], c[i + 2], px, py, pz)
            continue
        if kind == CYLINDER:
            count = _axis(n, c, x, point, s, count, d, 2, c[f + 1], c[i + 1], px, py, pz)
            d = 0.0
        elif kind == CAPSULE:
            d = d - min(max(d, -c[i + 1]), c[i + 1])
        elif kind != BALL:  # HALF_SPACE
            _local_row(n, c, x, point, s, count, 0.0, 0.0, 1.0, far + BEYOND * (c[i] - c[f]), px, py, pz)
            count += 1
            continue
        norm = np.sqrt(a * a + b * b + d * d)
        if norm > c[i]:
            _local_row(
                n, c, x, point, s, count, a / norm, b / norm, d / norm,
                norm - c[i] + BEYOND * (c[f] - c[i]), px, py, pz,
            )  # fmt: skip
            count += 1
    return count


@njit(cache=True)
def _step(n, x, count, damping):
    """Compute one step of the projection onto the constraints, `J^T (J J^T + damping)^-1 r`, by L D L^T
    decomposition.

    Return the offset in x at which the step is stored, behind the linear system.
    """
    dof, J = n[DOF], n[WORK] + 32
    r, A = J + MAX_ROWS * dof, J + MAX_ROWS * (dof + 2)
    y, step = r + MAX_ROWS, A + MAX_ROWS * MAX_ROWS
    for i in range(count):
        for j in range(i + 1):
            s = damping if i == j else 0.0
            for k in range(dof):
                s += x[J + i * dof + k] * x[J + j * dof + k]
            x[A + i * MAX_ROWS + j] = s
    for j in range(count):
        d = x[A + j * MAX_ROWS + j]
        for k in range(j):
            d -= x[A + j * MAX_ROWS + k] ** 2 * x[A + k * MAX_ROWS + k]
        d = max(d, 1e-15)
        x[A + j * MAX_ROWS + j] = d
        for i in range(j + 1, count):
            s = x[A + i * MAX_ROWS + j]
            for k in range(j):
                s -= x[A + i * MAX_ROWS + k] * x[A + j * MAX_ROWS + k] * x[A + k * MAX_ROWS + k]
            x[A + i * MAX_ROWS + j] = s / d
    for i in range(count):
        s = x[r + i]
        for k in range(i):
            s -= x[A + i * MAX_ROWS + k] * x[y + k]
        x[y + i] = s
    for i in range(count - 1, -1, -1):
        s = x[y + i] / x[A + i * MAX_ROWS + i]
        for k in range(i + 1, count):
            s -= x[A + k * MAX_ROWS + i] * x[y + k]
        x[y + i] = s
    for j in range(dof):
        s = 0.0
        for i in range(count):
            s -= x[J + i * dof + j] * x[y + i]
        x[step + j] = s
    return step


@njit(cache=True)
def project(n, c, x, q, at, lower, upper):
    """Project the joint positions at q[at:] onto the constraints: move the joints, between `lower` and
    `upper`, until all constraint errors are within the planning tolerances.

    Returns:
        Whether the projection succeeded.
    """
    dof, previous, stalled = n[DOF], 1e300, 0
    for _ in range(ITERATIONS):
        place_links(n, c, x, q, at)
        count = rows(n, c, x)
        if count == 0:
            return True
        J = n[WORK] + 32
        cost = 0.0
        for i in range(count):
            cost += x[J + MAX_ROWS * dof + i] ** 2
        stalled = stalled + 1 if cost > PROGRESS * previous else 0
        previous = cost
        if stalled >= PATIENCE:
            return False
        step = 0
        for _ in range(3):  # repeat without the joints at a bound
            step = _step(n, x, count, DAMPING * cost + BIAS)
            pressing = False
            for j in range(dof):
                d = x[step + j]
                if (d > 0.0 and q[at + j] >= upper[j]) or (d < 0.0 and q[at + j] <= lower[j]):
                    pressing = True
                    for i in range(count):
                        x[J + i * dof + j] = 0.0
            if not pressing:
                break
        largest = 0.0
        for j in range(dof):
            largest = max(largest, abs(x[step + j]))
        f = 1.0 if largest < LARGEST_STEP else LARGEST_STEP / largest
        for j in range(dof):
            q[at + j] = min(max(q[at + j] + f * x[step + j], lower[j]), upper[j])
    return False


@njit(cache=True, nogil=True)
def project_positions(handle, q, lower, upper):
    """Project joint positions q (dof,) onto the constraints. This function takes arrays and calls the kernel
    `project`.
    """
    n, c, x = manifold_pointers(handle)
    return project(n, c, x, pointer(q), 0, pointer(lower), pointer(upper))
