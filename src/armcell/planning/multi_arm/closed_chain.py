"""Inverse kinematics of a closed chain of two arms, and RRT-Connect over object poses.

Two arms that hold one object form a closed chain: six of their joints are free, and while no arm changes its
branch, the object's pose determines all joints. The search therefore runs in the space of poses (three
dimensions of position, three of rotation), and inverse kinematics follows every edge in small steps: the
grasps hold exactly along the whole path. (Projecting both arms' joints onto the chain would search twelve
dimensions for the same six, and would hold the grasps only up to the convergence of the projection.)

After Kuffner and LaValle, "RRT-Connect", ICRA 2000. The trees meet in a pose; a final check verifies that the
joints can follow the whole path from the start.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import SE3, SO3
from armcell.kinematics import ik_solver
from armcell.planning.multi_arm.object_paths import length
from armcell.scene import PlanningScene

Array = NDArray[np.float64]

JUMP = 0.2  # [rad] largest joint step between near poses; a larger step means another branch


@dataclass(frozen=True, eq=False)
class CarriedObject:
    """Object that two hands hold in a closed chain, with the pose of each hand's TCP in the object's
    frame.
    """

    name: str
    grasps: Mapping[str, SE3]  # by group, T_object_tcp
    tips: Mapping[str, str]  # by group, the TCP link

    @property
    def radius(self) -> float:
        """Upper bound [m] on the distance between a hand and the origin of the object that a closed chain
        holds.

        The radius converts rotations of the object to lengths.
        """
        return max(0.1, *(float(np.linalg.norm(T.translation)) for T in self.grasps.values()))


@dataclass(frozen=True)
class ClosedChainFailure:
    """Reason why one of the two arms in a closed chain cannot follow the object that they hold."""

    group: str
    share: float  # share of the path at which the arm fails
    jumps: bool  # a joint would jump; otherwise the pose is out of reach

    def __str__(self) -> str:
        at = f"{100 * self.share:.0f} %"
        if self.jumps:
            return f"{self.group} would have to change its posture at {at}"
        return f"{self.group} does not reach {at} of it"


class ClosedChainIK:
    """Inverse kinematics of a closed chain: two arms that hold one object with fixed grasps.

    Positions `q` contain all joints (dof,).
    """

    def __init__(self, scene: PlanningScene, carried: CarriedObject):
        self.carried = carried
        self.solvers = {g: ik_solver(scene.model, g, carried.tips[g]) for g in carried.grasps}

    def solve(
        self, T: SE3, last: Array, share: float = 0.0, jump: float = JUMP
    ) -> Array | ClosedChainFailure:
        """Solve the inverse kinematics of a closed chain for the object at pose T (T_world_object). The
        solution is on the same IK branch as the joint positions `last`.
        """
        new = last.copy()
        for group, ik in self.solvers.items():
            near = ik.nearest(T @ self.carried.grasps[group], last, among=8)
            if not near:
                return ClosedChainFailure(group, share, False)
            if np.max(np.abs(near[0] - last[ik.columns])) > jump:
                return ClosedChainFailure(group, share, True)
            new[ik.columns] = near[0]
        return new

    def solve_path(self, poses: Sequence[SE3], shares: Array, q: Array) -> Array | ClosedChainFailure:
        """Solve the inverse kinematics of a closed chain along several object poses; each solution (k, dof)
        is near the previous one.
        """
        rows, last = [], q
        for T, share in zip(poses, shares, strict=True):
            last = self.solve(T, last, float(share))
            if isinstance(last, ClosedChainFailure):
                return last
            rows.append(last)
        return np.array(rows)

    def postures(self, T: SE3, q: Array) -> list[Array] | ClosedChainFailure:
        """List the joint solutions of a closed chain for the object at pose T, on all branches of both arms;
        those nearest to q come first.
        """
        options = []
        for group, ik in self.solvers.items():
            options.append(ik.nearest(T @ self.carried.grasps[group], q, among=8))
            if not options[-1]:
                return ClosedChainFailure(group, 1.0, False)
        found = []
        for choice in product(*options):
            new = q.copy()
            for ik, own in zip(self.solvers.values(), choice, strict=True):
                new[ik.columns] = own
            found.append(new)
        return sorted(found, key=lambda p: float(np.abs(p - q).max()))


STRIDE, SWING = 0.03, 0.06  # [m] and [rad] of the object between two solutions of the inverse kinematics
LEAP = 0.4  # [rad] largest joint step between solutions; a larger step means another branch
STEP = 1 / 32  # [rad] of the joints between validity checks
REACH = 10  # strides per extension
SPREAD = 0.5  # [m] sampling range beyond start and goal
LEVEL = 0.5  # share of samples with an orientation of the straight path
SHORTCUTS = 120
WORTHWHILE = 0.98  # largest length ratio of a shortcut
SAME = 1e-3  # [rad] tolerance of equal joint positions


@dataclass(frozen=True, eq=False)
class SearchLimits:
    """Limits of a search over the object poses of a closed chain: a deadline and an event that cancels the
    search.
    """

    deadline: float  # [s] of time.monotonic()
    cancel: threading.Event

    @property
    def over(self) -> bool:
        """Whether a search over the object poses of a closed chain must end, because it is canceled or its
        deadline has passed.
        """
        return self.cancel.is_set() or time.monotonic() > self.deadline


class _Tree:
    """Search tree of RRT-Connect whose nodes are object poses, each with joint positions (dof,) of the closed
    chain.
    """

    def __init__(self, radius: float):
        self.radius = radius
        self.keys = np.empty((256, 12))
        self.poses: list[SE3] = []
        self.q: list[Array] = []
        self.parents: list[int] = []

    def _key(self, T: SE3) -> Array:
        """Convert an object pose to 12 coordinates for the search tree of a closed chain: translation and
        rotation matrix.
        """
        return np.concatenate([T.translation, (self.radius / np.sqrt(2)) * T.rotation.matrix.ravel()])

    def add(self, T: SE3, q: Array, parent: int) -> int:
        n = len(self.parents)
        if n == len(self.keys):
            self.keys = np.vstack([self.keys, np.empty_like(self.keys)])
        self.keys[n] = self._key(T)
        self.poses.append(T)
        self.q.append(q)
        self.parents.append(parent)
        return n

    def nearest(self, T: SE3) -> int:
        gaps = self.keys[: len(self.parents)] - self._key(T)
        return int(np.argmin(np.einsum("ij,ij->i", gaps, gaps)))

    def branch(self, node: int) -> Iterator[SE3]:
        """Yield the object poses in the search tree of a closed chain, from a node back to the root."""
        while node >= 0:
            yield self.poses[node]
            node = self.parents[node]


class ObjectPoseSearch:
    """RRT-Connect search over the poses of an object that two arms hold as a closed chain. It finds a
    collision-free path of the object.

    Args:
        checker: checker of both arms' joints. q: all joints (dof,) at the start. ends: joint positions
            allowed at the goal.
    """

    def __init__(
        self, hands: ClosedChainIK, checker: KernelChecker, start: SE3, q: Array, goal: SE3,
        ends: Sequence[Array],
        rng: np.random.Generator, limits: SearchLimits,
    ):  # fmt: skip
        self.hands, self.checker, self.rng, self.limits = hands, checker, rng, limits
        self.start, self.q, self.goal = start, q, goal
        self.radius = hands.carried.radius
        self.ahead, self.back = _Tree(self.radius), _Tree(self.radius)
        self.ahead.add(start, q, -1)
        for end in ends:
            self.back.add(goal, end, -1)
        corners = np.array([start.translation, goal.translation])
        self.low, self.high = corners.min(axis=0) - SPREAD, corners.max(axis=0) + SPREAD

    def find_poses(self) -> list[SE3] | None:
        """Search for a path of object poses from start to goal that a closed chain can follow.
        The object moves in a straight line from pose to pose. Shortcuts then shorten the path.

        Return None if the search is stopped.
        """
        grown, other = self.ahead, self.back
        while not self.limits.over:
            target = self._sample()
            node = self._extend(grown, target, REACH)
            if node is not None:
                met = self._extend(other, grown.poses[node[0]], None)
                if met is not None and met[1]:
                    mine, its = (node[0], met[0]) if grown is self.ahead else (met[0], node[0])
                    poses = [*list(self.ahead.branch(mine))[::-1], *list(self.back.branch(its))[1:]]
                    if self._followed(poses, self.q) is not None:
                        return self._shortened(poses)
            grown, other = other, grown
        return None

    def _sample(self) -> SE3:
        rng = self.rng
        position = rng.uniform(self.low, self.high)
        rotation = self.start.interpolate(self.goal, float(rng.random())).rotation
        if rng.random() > LEVEL:
            axis = rng.normal(size=3)
            angle = np.pi * rng.random() ** 2
            rotation = rotation @ SO3.exp(angle * axis / np.linalg.norm(axis))
        return SE3(rotation, position)

    def _extend(self, tree: _Tree, target: SE3, most: int | None) -> tuple[int, bool] | None:
        """Extend one tree of the object pose search toward a target pose, by at most `most` steps. Both arms
        hold the object at every step (closed chain).

        Return the new node and whether it is at the pose; None if no stride is possible.
        """
        near = tree.nearest(target)
        if length(tree.poses[near], target, self.radius) < 1e-9:
            return near, True
        reached = self._walk(tree.poses[near], tree.q[near], target, most)
        if reached is None:
            return None
        T, q, arrived = reached
        return tree.add(T, q, near), arrived

    def _walk(self, T: SE3, q: Array, target: SE3, most: int | None = None) -> tuple[SE3, Array, bool] | None:
        """Move the object of a closed chain on a straight line from T toward a pose, until an arm cannot
        follow or a contact blocks it.
        """
        meters, radians = T.distance_to(target)
        count = max(int(np.ceil(max(meters / STRIDE, radians / SWING))), 1)
        columns, at, arrived = self.checker.columns, None, False
        for k in range(1, min(count, most or count) + 1):
            pose = target if k == count else T.interpolate(target, k / count)
            new = self.hands.solve(pose, q, jump=LEAP)
            if isinstance(new, ClosedChainFailure) or not self.checker.edge_is_free(
                q[columns], new[columns], STEP
            ):
                break
            at, q, arrived = pose, new, k == count
            if k % REACH == 0 and self.limits.over:
                break
        return None if at is None else (at, q, arrived)

    def _shortened(self, poses: list[SE3]) -> list[SE3]:
        """Shorten a path of object poses with straight shortcuts that the two arms of the closed chain can
        follow.
        """
        joints = self._followed(poses, self.q)
        for _ in range(SHORTCUTS):
            if joints is None or len(poses) < 3 or self.limits.over:
                break
            ends = np.concatenate([[0.0], np.cumsum([length(a, b, self.radius) for a, b in pairwise(poses)])])
            low, high = np.sort(self.rng.uniform(-0.2, 1.2, 2).clip(0, 1)) * ends[-1]
            i = min(int(np.searchsorted(ends, low, side="right")) - 1, len(poses) - 2)
            j = min(int(np.searchsorted(ends, high, side="right")) - 1, len(poses) - 2)
            if i == j or high - low < STRIDE:
                continue
            first, last = (
                poses[k].interpolate(poses[k + 1], float((at - ends[k]) / (ends[k + 1] - ends[k])))
                for k, at in ((i, low), (j, high))
            )
            if length(first, last, self.radius) > WORTHWHILE * (high - low):
                continue
            middle = [T for T in (first, last) if self._apart(T, poses[i]) and self._apart(T, poses[j + 1])]
            tried = [*poses[: i + 1], *middle, *poses[j + 1 :]]
            part = self._followed(tried[i : i + len(middle) + 2], joints[i])
            if part is not None and np.max(np.abs(part[-1] - joints[j + 1])) < SAME:
                joints = [*joints[:i], *part, *joints[j + 2 :]]
                poses = tried
        return poses

    def _apart(self, a: SE3, b: SE3) -> bool:
        return length(a, b, self.radius) > 1e-6

    def _followed(self, poses: Sequence[SE3], q: Array) -> list[Array] | None:
        """Compute the joint positions of a closed chain along object poses, starting with q. Return None if
        the path is not collision-free.
        """
        found = [q]
        for a, b in pairwise(poses):
            reached = self._walk(a, found[-1], b)
            if reached is None or not reached[2]:
                return None
            found.append(reached[1])
        return found

    @property
    def poses_tried(self) -> int:
        """Number of object poses in both search trees of a closed chain."""
        return len(self.ahead.parents) + len(self.back.parents)
