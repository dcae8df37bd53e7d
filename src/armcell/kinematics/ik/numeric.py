"""Numeric inverse kinematics for any chain: damped least squares from many seeds (Numba).

The damping follows Sugihara, "Solvability-unconcerned inverse kinematics by the Levenberg-Marquardt
method" (IEEE T-RO 2011): squared error plus a small bias.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from armcell.core import SE3, ErrorCode, IKResult, InputError
from armcell.kinematics.tree import KinematicTree, chain_jacobian, forward, kinematic_tree
from armcell.model import RobotModel

Array = NDArray[np.float64]
Validity = Callable[[Array], bool]


@dataclass(frozen=True)
class IKSettings:
    """Settings of the numeric solver."""

    position_tolerance: float = 1e-6  # [m]
    rotation_tolerance: float = 1e-5  # [rad]
    max_iterations: int = 60  # per seed
    seeds: int = 40  # random restarts after the reference itself
    solutions: int = 8  # distinct valid solutions to choose the nearest from


@njit(cache=True)
def pose_error(T, target, out):
    """Position error [m] over rotation vector [rad], world frame, from T to target; returns the norms."""
    for i in range(3):
        out[i] = target[i, 3] - T[i, 3]
    R = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            R[i, j] = target[i, 0] * T[j, 0] + target[i, 1] * T[j, 1] + target[i, 2] * T[j, 2]
    ax, ay, az = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    sine = 0.5 * np.sqrt(ax * ax + ay * ay + az * az)
    cosine = 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0)
    angle = np.arctan2(sine, cosine)
    if sine > 1e-9:
        k = 0.5 * angle / sine
        out[3], out[4], out[5] = k * ax, k * ay, k * az
    elif cosine > 0:
        out[3], out[4], out[5] = 0.5 * ax, 0.5 * ay, 0.5 * az
    else:  # half a turn: the axis is the column of R + I that is longest
        best, length = 0, -1.0
        for j in range(3):
            n = 1.0 + R[j, j]
            if n > length:
                best, length = j, n
        norm = 0.0
        for i in range(3):
            out[3 + i] = R[i, best] + (1.0 if i == best else 0.0)
            norm += out[3 + i] ** 2
        for i in range(3):
            out[3 + i] *= np.pi / np.sqrt(norm)
    position = np.sqrt(out[0] ** 2 + out[1] ** 2 + out[2] ** 2)
    return position, angle


@njit(cache=True)
def descend(
    parent,
    T_parent_joint,
    kind,
    axis,
    column,
    multiplier,
    offset,
    joints,
    tip,
    columns,
    group_column,
    lower,
    upper,
    target,
    q,
    iterations,
    position_tolerance,
    rotation_tolerance,
):
    """Improve q (dof,) in place; returns position error, rotation error and whether it converged."""
    n = len(columns)
    Ts = np.empty((len(parent) + 1, 4, 4))
    J = np.empty((6, n))
    e = np.empty(6)
    position, angle = 0.0, 0.0
    previous, stalled = 1e9, 0
    for _ in range(iterations):
        forward(parent, T_parent_joint, kind, axis, column, multiplier, offset, q, Ts)
        position, angle = pose_error(Ts[tip], target, e)
        if position <= position_tolerance and angle <= rotation_tolerance:
            return position, angle, True
        cost = position * position + angle * angle
        stalled = stalled + 1 if cost > 0.98 * previous else 0
        previous = cost
        if stalled > 8:
            break
        chain_jacobian(Ts, Ts[tip, :3, 3], joints, kind, axis, column, multiplier, group_column, J)
        A = J @ J.T
        damping = 0.1 * cost + 1e-7
        for i in range(6):
            A[i, i] += damping
        step = J.T @ np.linalg.solve(A, e)
        largest = np.max(np.abs(step))
        factor = 1.0 if largest < 0.5 else 0.5 / largest
        for k in range(n):
            c = columns[k]
            q[c] = min(max(q[c] + factor * step[k], lower[k]), upper[k])
    return position, angle, False


class NumericIK:
    """Solver for one group and tip link of a model."""

    def __init__(
        self, model: RobotModel, group: str, tip_link: str | None = None, settings: IKSettings = IKSettings()
    ):
        self.model, self.settings = model, settings
        self.group = model.group(group)
        tip = tip_link or self.group.tip_link
        if tip is None:
            raise InputError(
                f"group {group!r} is not a chain, so it has no tip", cure="name the link to place"
            )
        model.link(tip)
        self.tip_link = tip
        self.tree: KinematicTree = kinematic_tree(model)
        self.joint_names = self.group.joint_names
        self.columns = np.array(model.columns(self.joint_names), dtype=np.int64)
        self.group_column = np.full(model.dof, -1, dtype=np.int64)
        self.group_column[self.columns] = np.arange(len(self.columns))
        self.joints = self.tree.path_to(tip)
        self.tip = self.tree.link_index[tip]
        low, high = model.lower[self.columns], model.upper[self.columns]
        self.lower = np.where(np.isfinite(low), low, -np.pi)
        self.upper = np.where(np.isfinite(high), high, np.pi)

    def descend(self, q: Array, T_world_tip: SE3, iterations: int | None = None) -> tuple[float, float, bool]:
        """One descent from q (dof,), changed in place: errors [m], [rad], and whether it converged."""
        t, s = self.tree, self.settings
        return descend(
            t.parent,
            t.T_parent_joint,
            t.kind,
            t.axis,
            t.column,
            t.multiplier,
            t.offset,
            self.joints,
            self.tip,
            self.columns,
            self.group_column,
            self.lower,
            self.upper,
            T_world_tip.matrix,
            q,
            s.max_iterations if iterations is None else iterations,
            s.position_tolerance,
            s.rotation_tolerance,
        )

    def solutions(self, T_world_tip: SE3, reference: ArrayLike, rng: np.random.Generator) -> Iterator[Array]:
        """Distinct solutions (n,) within limits, from the reference (dof,) first and then random seeds."""
        reference = np.asarray(reference, dtype=float)
        found: list[Array] = []
        for seed in range(self.settings.seeds + 1):
            q = reference.copy()
            if seed:
                q[self.columns] = rng.uniform(self.lower, self.upper)
            if not self.descend(q, T_world_tip)[2]:
                continue
            solution = nearest_equivalent(q[self.columns], reference[self.columns], self)
            if all(np.max(np.abs(solution - other)) > 1e-2 for other in found):
                found.append(solution)
                yield solution

    def solve(
        self,
        T_world_tip: SE3,
        reference: ArrayLike,
        is_valid: Validity | None = None,
        rng: np.random.Generator | None = None,
    ) -> IKResult:
        """The valid solution nearest to the reference.

        Args:
            T_world_tip: wanted pose of the tip link.
            reference: positions (dof,) of all joints; the group's are where the search begins.
            is_valid: whether group positions (n,) may be used (collision, say).
        Returns:
            SUCCESS with `positions` (n,); NO_IK_SOLUTION with the closest found and, in the evidence,
            how many solutions were invalid.
        """
        rng = rng or np.random.default_rng(0)
        reference = np.asarray(reference, dtype=float)
        valid, rejected = [], []
        for solution in self.solutions(T_world_tip, reference, rng):
            (valid if is_valid is None or is_valid(solution) else rejected).append(solution)
            if len(valid) >= self.settings.solutions:
                break
        if valid:
            best = min(valid, key=lambda q: float(np.linalg.norm(q - reference[self.columns])))
            return IKResult(ErrorCode.SUCCESS, positions=best, position_error=0.0, rotation_error=0.0)
        if rejected:
            best = min(rejected, key=lambda q: float(np.linalg.norm(q - reference[self.columns])))
            message = f"{len(rejected)} solution(s) reach the pose, each of them in collision"
            return IKResult(
                ErrorCode.NO_IK_SOLUTION,
                message,
                {"invalid_solutions": len(rejected), "invalid": rejected},
                positions=best,
                position_error=0.0,
                rotation_error=0.0,
            )
        return self._closest(T_world_tip, reference, rng)

    def _closest(self, T_world_tip: SE3, reference: Array, rng: np.random.Generator) -> IKResult:
        """Evidence for a pose out of reach: the nearest the tip can get in position, and its joints."""
        best_q, best = reference, (np.inf, np.inf)
        for seed in range(12):
            q = reference.copy()
            if seed:
                q[self.columns] = rng.uniform(self.lower, self.upper)
            position, angle, _ = self.descend(q, T_world_tip, 200)
            if position + 0.1 * angle < best[0] + 0.1 * best[1]:
                best_q, best = q, (position, angle)
        at = best_q[self.columns]
        limits = [n for n, v, lo, hi in zip(self.joint_names, at, self.lower, self.upper, strict=True)
                  if v - lo < 1e-3 or hi - v < 1e-3]  # fmt: skip
        reached = self.tree.link_pose(best_q, self.tip_link)
        message = (
            f"{self.tip_link} cannot reach the pose: the closest is {best[0] * 1000:.0f} mm and "
            f"{np.rad2deg(best[1]):.0f} deg away"
            + (f", with {', '.join(limits)} at the limit" if limits else "")
        )
        evidence = {"closest_pose": reached, "joints_at_limit": limits}
        return IKResult(
            ErrorCode.NO_IK_SOLUTION,
            message,
            evidence,
            positions=at,
            position_error=best[0],
            rotation_error=best[1],
        )


def nearest_equivalent(q: Array, reference: Array, ik: NumericIK) -> Array:
    """The same pose with revolute joints turned by whole turns towards the reference, within limits."""
    result = q.copy()
    for k, name in enumerate(ik.joint_names):
        joint = ik.model.joints[name]
        if joint.type == "prismatic":
            continue
        turns = np.round((reference[k] - q[k]) / (2 * np.pi))
        for candidate in (turns, turns - np.sign(turns)):
            value = q[k] + 2 * np.pi * candidate
            if joint.limits.lower - 1e-9 <= value <= joint.limits.upper + 1e-9:
                result[k] = value
                break
    return result
