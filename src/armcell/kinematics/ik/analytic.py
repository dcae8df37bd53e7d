"""Analytic inverse kinematics for arms with the kinematic structure of Universal Robots (Numba).

The solver finds all (up to eight) solution branches exactly. The structure: axis 2 crosses axis 1 at a
right angle; axes 2, 3 and 4 are parallel; axis 5 crosses axis 4, and axis 6 crosses axis 5, at right
angles. The solver finds the structure in the axes themselves, so neither the robot's name nor the
frames of its URDF matter. The formulas are geometry in the arm's own frame (compare Hawkins, "Analytic
inverse kinematics for the Universal Robots UR-5/UR-10 arms", 2013, in Denavit-Hartenberg terms):

- The frame: origin where axes 1 and 2 cross, z along axis 1, y along axis 2 when joint 1 is at zero. The
  arm's plane turns with joint 1; `v` is its normal, the direction of axes 2, 3 and 4.
- Axes 5 and 6 cross in C, which the goal fixes. C keeps the offset h from the plane: two angles of
  joint 1.
- Axis 5 is at right angles to v and to axis 6: two directions. They give joints 5 and 6 and the sum of
  joints 2, 3 and 4.
- Axes 4 and 5 cross in W, d from C along axis 5. Two links reach W in the plane: two elbows.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from armcell.core import InputError
from armcell.kinematics.ik.chain import SLIDE, Chain, chain_of, errors_at, tip_pose
from armcell.kinematics.ik.full_turns import wrap_and_sort_solutions
from armcell.kinematics.ik.solver import ChainData, IKSolver, ik_solvers, other_columns, tip_of
from armcell.kinematics.tree import FIXED, kinematic_tree
from armcell.model import RobotModel

F64 = NDArray[np.float64]

STRUCTURE = 1e-7  # [rad or m] tolerance of the structure (URDFs write pi / 2 with 10 digits)
REACH = 2e-7  # [m] a goal that is out of reach by less counts as on the boundary
SINGULAR = 1e-8  # sine of the angle between axes 4 and 6 below which joint 6 is free
SAME = 1e-6  # [rad] solutions with a smaller difference count as one
BRANCHES = 8


def ur_geometry(chain: Chain) -> F64 | None:
    """Return the geometry of a UR arm as analytic IK needs it, or None if the arm has a different
    structure.
    """
    table = chain.table
    order = table[:, 15].astype(int)
    plain = np.all(table[:, 12] == 1.0) and np.all(table[:, 13] == 0.0) and not np.any(table[:, SLIDE])
    if len(table) != 6 or len(chain.bounds) != 6 or not plain or sorted(order) != list(range(6)):
        return None
    axes, T = np.empty((6, 6)), np.empty(12)
    tip_pose(table, np.zeros(6), axes, T)
    z, p = axes[:, :3].copy(), axes[:, 3:]
    signs = np.ones(6)
    for k in (2, 3):  # parallel to axis 2, perhaps in the opposite direction
        signs[k] = np.sign(z[k] @ z[1]) or 1.0
        z[k] *= signs[k]
    # By construction of the chain, p[0] is the origin and z[0] is z; from here all is in the base frame.
    parallel = max(np.linalg.norm(np.cross(z[k], z[1])) for k in (2, 3))
    square = max(abs(z[0] @ z[1]), abs(z[3] @ z[4]), abs(z[4] @ z[5]))
    if max(parallel, square) > STRUCTURE:
        return None
    y, up = z[1], z[0]
    x = np.cross(y, up)
    apart = [np.cross(z[i], z[j]) @ (p[j] - p[i]) for i, j in ((0, 1), (3, 4), (4, 5))]
    if np.max(np.abs(apart)) > STRUCTURE:
        return None
    center = up * (up @ p[1])  # intersection of axes 1 and 2
    C = p[4] + z[4] * (z[4] @ (p[5] - p[4]))
    W = p[4] + z[4] * (z[4] @ (p[3] - p[4]))
    upper, fore = _flat(x, up, p[2] - center), _flat(x, up, W - p[2])
    lengths = np.linalg.norm(upper), np.linalg.norm(fore)
    if min(lengths) < 1e-3:
        return None
    R, t = T.reshape(3, 4)[:, :3], T.reshape(3, 4)[:, 3]
    geometry = np.concatenate(
        [
            x, y, up, center,  # 0: the arm's frame
            R.T @ (C - t), R.T @ z[5], R.T @ z[4],  # 12: C, axis 6 and, at zero, axis 5, in the tip's frame
            [y @ (C - center), z[4] @ (C - W), *lengths],  # 21: h, d, upper arm, forearm
            [np.arctan2(*upper), np.arctan2(*fore), np.arctan2(*_flat(x, up, z[4]))],  # 25: angles at zero
            [np.arctan2(np.cross(y, z[5]) @ z[4], y @ z[5])],  # 28: from axis 4 to axis 6 at zero
            signs, order,  # 29, 35
        ]
    )  # fmt: skip
    return geometry if _solves(geometry, chain) else None


def _flat(x: F64, z: F64, v: F64) -> F64:
    """Return the coordinates (2,) of a vector v along the unit vectors x and z, for analytic IK. They span
    the plane in which a UR arm's upper arm and forearm move when joint 1 is at zero.

    The arctan2 of the coordinates is the angle from z, positive about y.
    """
    return np.array([v @ x, v @ z])


def _solves(geometry: F64, chain: Chain) -> bool:
    """Return whether analytic IK for UR arms finds correct and complete solutions for some test poses.

    Each solution must reach its pose, and the positions that define the pose must be among the solutions.
    """
    rng, T, out = np.random.default_rng(0), np.empty(12), np.empty((BRANCHES, 6))
    for q in rng.uniform(-np.pi, np.pi, (8, 6)):
        tip_pose(chain.table, q, np.empty((6, 6)), T)
        count = ur_branches(geometry, T, np.zeros(6), out)
        if max((max(errors_at(chain.table, other, T)) for other in out[:count]), default=1.0) > 5e-7:
            return False
        turns = (out[:count] - q) / (2 * np.pi)
        if np.min(np.max(np.abs(turns - np.round(turns)), axis=1)) > 1e-5:
            return False
    return True


@njit(cache=True, error_model="numpy")
def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(cache=True, error_model="numpy")
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, error_model="numpy")
def _wrapped(angle):
    return angle - 2.0 * np.pi * np.round(angle / (2.0 * np.pi))


@njit(cache=True, error_model="numpy")
def _turned(goal, at, geometry):
    """Rotate a direction at the tip of a UR arm (`geometry[at:at + 3]`) into the frame of the arm, for
    analytic IK.
    """
    a, b, c = geometry[at], geometry[at + 1], geometry[at + 2]
    vx = goal[0] * a + goal[1] * b + goal[2] * c
    vy = goal[4] * a + goal[5] * b + goal[6] * c
    vz = goal[8] * a + goal[9] * b + goal[10] * c
    g = geometry
    return (
        g[0] * vx + g[1] * vy + g[2] * vz,
        g[3] * vx + g[4] * vy + g[5] * vz,
        g[6] * vx + g[7] * vy + g[8] * vz,
    )


@njit(cache=True, error_model="numpy")
def _elbows(g, c1, s1, q1, C, axis6, tip5, axis5, reference, out, count):
    """Append the analytic IK solutions of a UR arm (at most two) for one direction of axis 5. Return the new
    number of solutions.
    """
    v = (-s1, c1, 0.0)
    x, z = c1 * (C[0] - g[22] * axis5[0]) + s1 * (C[1] - g[22] * axis5[1]), C[2] - g[22] * axis5[2]
    upper, fore = g[23], g[24]
    distance = np.sqrt(x * x + z * z)
    if distance > upper + fore + REACH or distance < abs(upper - fore) - REACH:
        return count
    nearer = max((upper + fore - distance) * (upper + fore + distance), 0.0)
    farther = max((distance - upper + fore) * (distance + upper - fore), 0.0)
    # The bend of the elbow: tan(bend / 2)^2 = nearer / farther.
    bend = 2.0 * np.arctan2(np.sqrt(nearer), np.sqrt(farther))
    q5 = np.arctan2(_dot(_cross(v, axis6), axis5), _dot(v, axis6)) - g[28]
    q6 = np.arctan2(_dot(_cross(axis5, tip5), axis6), _dot(axis5, tip5))
    total = np.arctan2(c1 * axis5[0] + s1 * axis5[1], axis5[2]) - g[27]
    for side in range(2):
        turn = bend if side == 0 else -bend
        if distance > SINGULAR:
            q2 = np.arctan2(x, z) - np.arctan2(fore * np.sin(turn), upper + fore * np.cos(turn)) - g[25]
        else:  # the wrist is on axis 2: joint 2 is free
            q2 = reference[int(g[36])]
        q3 = turn - (g[26] - g[25])
        q4 = total - q2 - q3
        row = out[count]
        row[int(g[35])], row[int(g[36])] = _wrapped(q1), _wrapped(q2)
        row[int(g[37])], row[int(g[38])] = _wrapped(g[31] * q3), _wrapped(g[32] * q4)
        row[int(g[39])], row[int(g[40])] = _wrapped(q5), _wrapped(q6)
        new = True
        for other in range(count):
            largest = 0.0
            for k in range(6):
                largest = max(largest, abs(_wrapped(row[k] - out[other, k])))
            new = new and largest > SAME
        if new:
            count += 1
    return count


@njit(cache=True, error_model="numpy")
def _free_wrist(g, c1, s1, q1, C, axis6, tip5, reference, out, count):
    """Append the analytic IK solutions of a UR arm for a singular wrist: axes 4 and 6 are parallel, and joint
    6 can be chosen freely. Return the new number of solutions.

    Joint 6 takes the reference's position, or else the first of 16 positions that reaches the goal.
    """
    v = (-s1, c1, 0.0)
    nearest = np.arctan2(
        c1 * C[0] + s1 * C[1], C[2]
    )  # axis 5 along this line in the plane brings W nearest to axis 2
    for attempt in range(17):
        if attempt == 0:
            a = -reference[int(g[40])]
            ux, uy, uz = _cross(axis6, tip5)
            axis5 = (
                np.cos(a) * tip5[0] + np.sin(a) * ux,
                np.cos(a) * tip5[1] + np.sin(a) * uy,
                np.cos(a) * tip5[2] + np.sin(a) * uz,
            )
            away = _dot(axis5, v)  # projected exactly into the plane
            axis5 = (axis5[0] - away * v[0], axis5[1] - away * v[1], axis5[2])
            length = np.sqrt(_dot(axis5, axis5))
            axis5 = (axis5[0] / length, axis5[1] / length, axis5[2] / length)
        else:
            a = nearest + (attempt - 1) * np.pi / 8.0
            axis5 = (c1 * np.sin(a), s1 * np.sin(a), np.cos(a))
        more = _elbows(g, c1, s1, q1, C, axis6, tip5, axis5, reference, out, count)
        if more > count:
            return more
    return count


@njit(cache=True, error_model="numpy")
def ur_branches(geometry, goal, reference, out):
    """Fill `out` (8, 6) with the analytic IK solutions of a UR arm, with joints in (-pi, pi]. Return the
    number of solutions.

    Args:
        geometry: from `ur_geometry`.
        goal: (12,) T_base_tip of the chain.
        reference: positions (6,) of joints that are free in a singular pose.
    """
    g = geometry
    tip5, axis6 = _turned(goal, np.int64(18), g), _turned(goal, np.int64(15), g)
    C = _turned(goal, np.int64(12), g)
    tx, ty, tz = goal[3] - g[9], goal[7] - g[10], goal[11] - g[11]
    C = (
        C[0] + g[0] * tx + g[1] * ty + g[2] * tz,
        C[1] + g[3] * tx + g[4] * ty + g[5] * tz,
        C[2] + g[6] * tx + g[7] * ty + g[8] * tz,
    )
    h, radius = g[21], np.sqrt(C[0] * C[0] + C[1] * C[1])
    if radius < abs(h) - REACH:
        return 0
    count = np.int64(0)  # for a literal Numba would compile _elbows again
    for shoulder in range(2):
        depth = np.sqrt(max(radius - abs(h), 0.0) * (radius + abs(h)))
        if radius < SINGULAR:  # C is on axis 1 and has no offset: joint 1 is free
            q1 = reference[int(g[35])]
        else:
            q1 = np.arctan2(C[1], C[0]) - np.arctan2(h, depth if shoulder == 0 else -depth)
        if shoulder == 1 and depth == 0.0:
            break
        c1, s1 = np.cos(q1), np.sin(q1)
        nx, ny, nz = _cross((-s1, c1, 0.0), axis6)
        sine = np.sqrt(nx * nx + ny * ny + nz * nz)
        if sine < SINGULAR:
            count = _free_wrist(g, c1, s1, q1, C, axis6, tip5, reference, out, count)
            continue
        for wrist in range(2):
            s = 1.0 / sine if wrist == 0 else -1.0 / sine
            count = _elbows(g, c1, s1, q1, C, axis6, tip5, (nx * s, ny * s, nz * s), reference, out, count)
    return count


@ik_solvers.register("analytic")
class AnalyticIK(IKSolver):
    """Analytic IK solver for UR arms, which returns up to eight solutions, the one nearest to the reference
    first.

    Raises:
        InputError: the kinematic structure of the chain is not that of a UR arm.
    """

    method = "analytic"
    nearest_first = True

    @classmethod
    def solves(cls, model: RobotModel, group: str, tip_link: str | None = None) -> bool:
        return is_analytic(model, group, tip_link)

    def _prepare(self, positions: F64) -> ChainData:
        prepared = super()._prepare(positions)
        geometry = ur_geometry(prepared.chain)
        if geometry is None:
            raise InputError(
                f"group {self.group.name!r} of {self.model.name!r} is not built like a UR arm",
                hint="use ik_solver, which takes the solver that fits",
            )
        return replace(prepared, geometry=geometry)

    def _search(self, prepared: ChainData, goal: F64, reference: F64, rng: np.random.Generator | None,
                outside: dict[str, int]) -> Iterator[F64]:  # fmt: skip
        chain, found = prepared.chain, np.empty((BRANCHES, 6))
        forbidden = np.zeros(6, dtype=np.int64)
        count = ur_branches(prepared.geometry, goal, reference, found)
        yield from found[
            : wrap_and_sort_solutions(found, count, reference, chain.bounds, chain.turning, forbidden)
        ]
        outside.update({self.joint_names[k]: int(forbidden[k]) for k in np.flatnonzero(forbidden)})


def is_analytic(model: RobotModel, group: str, tip_link: str | None = None) -> bool:
    """Return whether analytic IK can be used: the kinematic chain of the planning group must have the
    structure of a UR arm.

    The result is True only if it does not depend on the positions of the robot's other joints.
    """
    names, tip = model.group(group).joint_names, tip_of(model, group, tip_link)
    tree = kinematic_tree(model)
    columns, others = set(model.columns(names)), set(other_columns(model, names, tip))
    moving = [int(tree.column[j]) for j in tree.path_to(tip) if tree.kind[j] != FIXED]
    own = [k for k, column in enumerate(moving) if column in columns]
    if len(own) != 6 or others & set(moving[own[0] : own[-1]]):
        return False
    return ur_geometry(chain_of(tree, names, tip, model.default_positions())) is not None
