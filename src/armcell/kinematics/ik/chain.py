"""The joints between a group's base and tip as one small table, with its kinematics (Numba).

Fixed joints are merged into their neighbors, and every axis is rotated to z, so that the tip's pose is
`base @ Z(v_0) @ link_0 @ Z(v_1) @ link_1 ...`, with `Z(v)` a rotation about or a translation along z. Poses
are stored as 12 numbers, the upper three rows of the 4x4 matrix; `goal` is always the tip's pose in the
frame `base`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from armcell.core import SE3, SO3, InputError
from armcell.kinematics.tree import FIXED, PRISMATIC, KinematicTree

Array = NDArray[np.float64]

MULTIPLIER, OFFSET, SLIDE, COLUMN, WIDTH = 12, 13, 14, 15, 16
FAST = {"contract", "reassoc", "nsz", "arcp"}  # without nnan: a NaN stays a NaN


@dataclass(frozen=True, eq=False)
class Chain:
    """Kinematic chain for IK: the joints that move a tip link, stored as arrays for compiled functions.

    Attributes:
        table: (m, 16) a row per moving joint, base first: `link` after the joint (12), multiplier and offset
            (mimic joints), 1 for a prismatic joint, column of the group joint that drives the joint.
        inverse_base: (12,) T_base_root.
        bounds: (n, 2) limits of the group's joints, infinite where there are none [rad or m].
        turning: (n,) whether a full turn of the joint leaves the tip's pose unchanged.
        reach: upper bound of the tip's distance from the first joint's origin [m].
    """

    table: Array
    inverse_base: Array
    bounds: Array
    turning: NDArray[np.bool_]
    reach: float

    @property
    def position_weight(self) -> float:
        """Weight [1/m] of a position error relative to a rotation error at the tip of an IK chain. With this
        weight, a position error equal to the arm's reach counts as much as 1 rad.
        """
        return 1.0 / self.reach if 0.0 < self.reach < np.inf else 1.0


def chain_of(tree: KinematicTree, joint_names: tuple[str, ...], tip_link: str, positions: Array) -> Chain:
    """Build the kinematic chain for IK, a table of the joints between the root and a link.

    Joints outside the group stay at `positions` (dof,).

    Raises:
        InputError: none of the joints moves the link.
    """
    column_of = {c: k for k, c in enumerate(tree.model.columns(joint_names))}
    base, at = np.eye(4), np.eye(4)
    rows: list[Array] = []
    for j in tree.path_to(tip_link):
        at = at @ tree.T_parent_joint[j]
        if tree.kind[j] == FIXED:
            continue
        turn = np.eye(4)
        turn[:3, :3] = SO3.between((0, 0, 1), tree.axis[j]).matrix
        column = column_of.get(int(tree.column[j]))
        if column is None:
            value = float(tree.multiplier[j] * positions[tree.column[j]] + tree.offset[j])
            at = at @ turn @ _about_z(value, tree.kind[j] == PRISMATIC) @ turn.T
            continue
        if rows:
            rows[-1][:12] = (at @ turn)[:3].ravel()
        else:
            base = at @ turn
        row = np.zeros(WIDTH)
        row[MULTIPLIER], row[OFFSET] = tree.multiplier[j], tree.offset[j]
        row[SLIDE], row[COLUMN] = tree.kind[j] == PRISMATIC, column
        rows.append(row)
        at = turn.T
    if not rows:
        raise InputError(f"none of {', '.join(joint_names)} moves link {tip_link!r}")
    rows[-1][:12] = at[:3].ravel()
    table = np.array(rows)
    limits = [tree.model.joints[name].limits for name in joint_names]
    bounds = np.array([(limit.lower, limit.upper) for limit in limits], dtype=float).reshape(-1, 2)
    turning = np.array([tree.model.joints[name].type != "prismatic" for name in joint_names])
    for row in table:  # a full turn changes the pose if a mimic joint turns by another ratio
        if row[MULTIPLIER] != np.round(row[MULTIPLIER]) or row[SLIDE]:
            turning[int(row[COLUMN])] = False
    return Chain(
        table, SE3.from_matrix(base).inverse().matrix[:3].ravel(), bounds, turning, _reach(table, bounds)
    )


def _about_z(value: float, slide: bool) -> Array:
    T = np.eye(4)
    if slide:
        T[2, 3] = value
    else:
        T[:3, :3] = SO3.exp((0, 0, value)).matrix
    return T


def _reach(table: Array, bounds: Array) -> float:
    length = 0.0
    for row in table:
        length += float(np.linalg.norm(row[[3, 7, 11]]))
        if row[SLIDE]:
            length += float(np.max(np.abs(row[MULTIPLIER] * bounds[int(row[COLUMN])] + row[OFFSET])))
    return length


@njit(cache=True, error_model="numpy")
def goal_in_base(inverse_base, T, goal):
    """Convert the tip's goal pose from the root frame to the base frame of an IK chain, and write it to
    `goal` as 12 numbers (3x4 matrix, row by row). Return whether all numbers are finite.
    """
    total = 0.0
    for i in range(3):
        for j in range(4):
            s = inverse_base[4 * i + 3] if j == 3 else 0.0
            for k in range(3):
                s += inverse_base[4 * i + k] * T[k, j]
            goal[4 * i + j] = s
            total += s
    return np.isfinite(total)


@njit(cache=True, fastmath=FAST, error_model="numpy")
def tip_pose(table, q, axes, T):
    """Compute the tip pose and the joint axes of an IK chain at joint positions q (n,), and write them to T
    (12,) and `axes` (m, 6).

    A row of `axes` contains a joint's direction and origin.
    """
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
    x, y, z = 0.0, 0.0, 0.0
    for k in range(len(table)):
        axes[k, 0], axes[k, 1], axes[k, 2], axes[k, 3], axes[k, 4], axes[k, 5] = r02, r12, r22, x, y, z
        t = table[k]
        value = t[MULTIPLIER] * q[int(t[COLUMN])] + t[OFFSET]
        if t[SLIDE] != 0.0:
            x, y, z = x + value * r02, y + value * r12, z + value * r22
        else:
            c, s = np.cos(value), np.sin(value)
            r00, r01 = c * r00 + s * r01, c * r01 - s * r00
            r10, r11 = c * r10 + s * r11, c * r11 - s * r10
            r20, r21 = c * r20 + s * r21, c * r21 - s * r20
        x += r00 * t[3] + r01 * t[7] + r02 * t[11]
        y += r10 * t[3] + r11 * t[7] + r12 * t[11]
        z += r20 * t[3] + r21 * t[7] + r22 * t[11]
        r00, r01, r02 = (
            r00 * t[0] + r01 * t[4] + r02 * t[8],
            r00 * t[1] + r01 * t[5] + r02 * t[9],
            r00 * t[2] + r01 * t[6] + r02 * t[10],
        )
        r10, r11, r12 = (
            r10 * t[0] + r11 * t[4] + r12 * t[8],
            r10 * t[1] + r11 * t[5] + r12 * t[9],
            r10 * t[2] + r11 * t[6] + r12 * t[10],
        )
        r20, r21, r22 = (
            r20 * t[0] + r21 * t[4] + r22 * t[8],
            r20 * t[1] + r21 * t[5] + r22 * t[9],
            r20 * t[2] + r21 * t[6] + r22 * t[10],
        )
    T[0], T[1], T[2], T[3] = r00, r01, r02, x
    T[4], T[5], T[6], T[7] = r10, r11, r12, y
    T[8], T[9], T[10], T[11] = r20, r21, r22, z


@njit(cache=True, fastmath=FAST, error_model="numpy")
def pose_error(T, goal, e):
    """Compute the error between the tip pose T of an IK chain and the goal, and write it to e (6,). Return
    the position error and the rotation error.

    e contains the position error [m] and the rotation vector [rad].
    """
    e[0], e[1], e[2] = goal[3] - T[3], goal[7] - T[7], goal[11] - T[11]
    R = np.empty((3, 3))  # goal's rotation times T's transposed
    for i in range(3):
        for j in range(3):
            R[i, j] = goal[4 * i] * T[4 * j] + goal[4 * i + 1] * T[4 * j + 1] + goal[4 * i + 2] * T[4 * j + 2]
    ax, ay, az = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    sine = 0.5 * np.sqrt(ax * ax + ay * ay + az * az)
    cosine = 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0)
    angle = np.arctan2(sine, cosine)
    if sine > 1e-9 or cosine > 0.0:
        k = 0.5 * angle / sine if sine > 1e-9 else 0.5
        e[3], e[4], e[5] = k * ax, k * ay, k * az
    else:  # half a turn: the axis is the longest column of R + 1
        best = 0
        for j in range(1, 3):
            if R[j, j] > R[best, best]:
                best = j
        norm = np.sqrt(2.0 * (1.0 + R[best, best]))
        for i in range(3):
            e[3 + i] = (R[i, best] + (1.0 if i == best else 0.0)) * np.pi / norm
    return np.sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2]), angle


@njit(cache=True)
def errors_at(table, q, goal):
    """Return the position error [m] and the rotation error [rad] that the tip of an IK chain has at joint
    positions q (n,).
    """
    T = np.empty(12)
    tip_pose(table, q, np.empty((len(table), 6)), T)
    return pose_error(T, goal, np.empty(6))
