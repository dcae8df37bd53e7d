"""Kinematic chain of a planning group in the kernel, and upper bounds on the motion of its bodies."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.model import RobotModel

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]
Branches = tuple[list[int], list[int]]

REVOLUTE_KIND = 1  # as in frames


@dataclass(frozen=True, eq=False)
class Chain:
    """Kinematic chain of a planning group in the kernel.
    It contains the frames that the group's joints move; all others are fixed.

    Attributes:
        joint_names: joints of the group, in the order of their columns.
        parent: parent of each frame; frame 0 is the world.
        fixed: (f, 12) pose of each frame in its parent frame at joint value 0, rows of a 3x4 matrix.
        kind: `REVOLUTE_KIND` for a frame that turns about z, 2 for one that slides along z, 0 for the world.
        column: column of the joint that moves each frame.
        multiplier, offset: joint value = multiplier * variable + offset [rad or m].
    """

    model: RobotModel
    joint_names: tuple[str, ...]
    parent: list[int]
    fixed: F64
    kind: list[int]
    column: list[int]
    multiplier: list[float]
    offset: list[float]

    @cached_property
    def arrays(self) -> dict[str, Any]:
        """Return the frames of a kernel chain in the format of a `Pack`."""
        return {
            "parent": np.array(self.parent, np.int32),
            "fixed": self.fixed.astype(np.float32).reshape(-1, 12),
            "kind": np.array(self.kind, np.int32),
            "column": np.array(self.column, np.int32),
            "multiplier": np.array(self.multiplier, np.float32),
            "offset": np.array(self.offset, np.float32),
        }

    @cached_property
    def _above(self) -> list[list[int]]:
        """Return, for each frame of a kernel chain, the frames from the world's child down to it."""
        above: list[list[int]] = [[]]
        for f in range(1, len(self.parent)):
            above.append([*above[self.parent[f]], f])
        return above

    @cached_property
    def _arm(self) -> list[float]:
        """Return the distance [m] from the origin of each frame's parent to the frame's own origin."""
        return [math.hypot(*T[[3, 7, 11]]) for T in self.fixed]

    def _branches(self, f: int, e: int) -> Branches:
        """Return the two chains of kernel frames that lead from the last common ancestor of two frames to
        each of the frames.

        The common frame itself is not included.
        """
        a, b = self._above[f], self._above[e]
        common = 0
        while common < min(len(a), len(b)) and a[common] == b[common]:
            common += 1
        return a[common:], b[common:]

    def between(self, f: int, e: int) -> tuple[Branches, list[int]]:
        """Return the branches of kernel frames that lead to two frames (see `_branches`), and the columns of
        the joints that move the frames of these branches.
        """
        branches = self._branches(f, e)
        return branches, sorted({self.column[frame] for branch in branches for frame in branch})

    def moves(self, frames: list[int], i: I32, j: I32) -> NDArray[np.bool_]:
        """Return a mask (pairs, dof): which joints of a kernel chain move the two bodies of a pair relative
        to each other.

        Args:
            frames: frame of each body.
            i, j: (pairs,) bodies of each pair.
        """
        above = np.zeros((len(frames), len(self.parent)), bool)
        for k, frame in enumerate(frames):
            above[k, self._above[frame]] = True
        column = np.zeros((len(self.parent), len(self.joint_names)))
        column[np.arange(1, len(self.parent)), self.column[1:]] = 1.0
        return (above[i] ^ above[j]) @ column > 0

    def ranges(self, columns: list[int]) -> tuple[F64, F64, NDArray[np.bool_]]:
        """Return the lower and upper limits (k,) [rad or m] of joint variables, and whether they turn: the
        values of such a joint repeat after one turn, so its limits are -pi and pi.
        """
        lower, upper, turns = np.zeros(len(columns)), np.zeros(len(columns)), np.zeros(len(columns), bool)
        for k, c in enumerate(columns):
            joint = self.model.joints[self.joint_names[c]]
            low, high = joint.limits.lower, joint.limits.upper
            turns[k] = not np.isfinite(high - low) or (high - low > 2 * np.pi and joint.type != "prismatic")
            lower[k], upper[k] = (-np.pi, np.pi) if turns[k] else (low, high)
        return lower, upper, turns

    def _span(self, frame: int) -> float:
        """Return the largest absolute position [rad or m] within the limits of a joint. The joint is given by
        the frame that it moves in the collision kernel.
        """
        limits = self.model.joints[self.joint_names[self.column[frame]]].limits
        return max(abs(limits.lower), abs(limits.upper))

    # --- motion bounds ---
    def reach(self, frame: int, around: F32) -> F64:
        """Return upper bounds (dof,) on how far [m] a robot body in the kernel moves per unit [rad or m] of
        each joint variable.

        Args:
            frame: frame of the body.
            around: (4,) sphere that contains the body, in this frame.
        """
        reach = np.zeros(len(self.joint_names))
        radius = float(np.linalg.norm(around[:3]) + around[3])
        while frame > 0:
            m, c = abs(self.multiplier[frame]), self.column[frame]
            if self.kind[frame] == REVOLUTE_KIND:
                reach[c] += m * radius
            else:
                reach[c] += m
                radius += m * self._span(frame) + abs(self.offset[frame])
            radius += self._arm[frame]
            frame = self.parent[frame]
        return reach * (1 + 1e-6)

    def group_reach(self, branch: list[int], columns: list[int], groups: F64) -> F64:
        """Return, for the robot's kernel arrays, upper bounds (groups, columns) on how far [m] each sphere
        group of a body moves per unit [rad or m] of each joint variable. Each column belongs to one joint
        variable.

        The bounds are like those of `reach`.

        Args:
            branch: frames from the common frame down to the body's frame.
            columns: joint columns of the result.
            groups: (g, 4) spheres in the body's frame.
        """
        radius = np.linalg.norm(groups[:, :3], axis=1) + groups[:, 3]
        reach = np.zeros((len(groups), len(columns)))
        for frame in reversed(branch):
            m, c = abs(self.multiplier[frame]), columns.index(self.column[frame])
            if self.kind[frame] == REVOLUTE_KIND:
                reach[:, c] += m * radius
            else:
                reach[:, c] += m
                radius = radius + m * self._span(frame) + abs(self.offset[frame])
            radius = radius + self._arm[frame]
        return reach

    def axis_reach(self, branch: list[int], columns: list[int], spheres: F64) -> F64:
        """Return upper bounds (columns,) on how far a robot body moves per unit of each joint variable. For
        one or two revolute joints, they are the largest distances from the joint axes, which is tighter than
        `group_reach`.

        Args:
            branch: frames from the common frame down to the body's frame.
            columns: joint columns of the result.
            spheres: (s, 4) spheres that cover the body, in its frame.
        """
        if len(branch) > 2 or any(self.kind[frame] != REVOLUTE_KIND for frame in branch):
            return self.group_reach(branch, columns, spheres).max(axis=0)
        reach = np.zeros(len(columns))
        around = np.linalg.norm(spheres[:, :2], axis=1) + spheres[:, 3]  # of the last joint's axis, z
        for frame in reversed(branch):
            reach[columns.index(self.column[frame])] += abs(self.multiplier[frame]) * around.max()
            T_parent = np.reshape(self.fixed[frame], (3, 4))
            on_axis = (
                T_parent[:, 3] + spheres[:, 2:3] * T_parent[:, 2]
            )  # of each sphere, in the parent's frame
            around = np.linalg.norm(on_axis[:, :2], axis=1) + around
        return reach
