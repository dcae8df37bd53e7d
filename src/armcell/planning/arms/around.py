"""A way round obstacles for an object in two hands: RRT-Connect over the object's pose.

Two arms that hold one object are a closed chain: of their joints six are free, and as long as no arm changes
its branch, the object's pose says where all of them are. So the search is in the space of poses (three of
position, three of rotation), and inverse kinematics follows every edge in small steps: the grasps hold
exactly all along. (A projection of both arms' joints onto the chain would search twelve dimensions for the
same six, and hold the grasps only as well as it converges.)

After Kuffner and LaValle, "RRT-Connect", ICRA 2000. Trees meet in a pose; what counts is that the joints can
follow from the start on, which is looked at again for the whole way.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import SE3, SO3
from armcell.planning.arms.carried import Hands, Stuck
from armcell.planning.arms.ways import length

Array = NDArray[np.float64]

STRIDE, SWING = 0.03, 0.06  # [m] and [rad] of the object between two solutions of the inverse kinematics
LEAP = 0.4  # [rad] of a joint between those: more is another branch
STEP = 1 / 32  # [rad] of the joints between validity checks
REACH = 10  # strides of an extension
SPREAD = 0.5  # [m] beyond start and goal that positions are sampled in
LEVEL = 0.5  # of the samples are turned as on the straight way somewhere
SHORTCUTS = 120
WORTHWHILE = 0.98  # of the length: a shortcut that leaves more is not taken
SAME = 1e-3  # [rad] between joints that came to one pose in two ways


@dataclass(frozen=True, eq=False)
class Limits:
    """When to stop."""

    deadline: float  # [s] of time.monotonic()
    cancel: threading.Event

    @property
    def over(self) -> bool:
        return self.cancel.is_set() or time.monotonic() > self.deadline


class _Tree:
    """Poses with all joints (dof,) there, and parents."""

    def __init__(self, radius: float):
        self.radius = radius
        self.keys = np.empty((256, 12))
        self.poses: list[SE3] = []
        self.q: list[Array] = []
        self.parents: list[int] = []

    def _key(self, T: SE3) -> Array:
        """Differences of these are as long as positions differ, and as a turn moves a point at the radius."""
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
        """Poses from a node to its root."""
        while node >= 0:
            yield self.poses[node]
            node = self.parents[node]


class PoseSearch:
    """One search from a pose of the object, with the joints there, to another.

    Args:
        checker: of both arms' joints. q, ends: all joints (dof,) at the start, and at the goal those that it
            may be come to with.
    """

    def __init__(
        self, hands: Hands, checker: KernelChecker, start: SE3, q: Array, goal: SE3, ends: Sequence[Array],
        rng: np.random.Generator, limits: Limits,
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

    def way(self) -> list[SE3] | None:
        """Poses from the start to the goal, straight in between, already shortened; None if stopped."""
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
        """A node as far towards a pose as it goes, in at most so many strides, and whether it is there."""
        near = tree.nearest(target)
        if length(tree.poses[near], target, self.radius) < 1e-9:
            return near, True
        reached = self._walk(tree.poses[near], tree.q[near], target, most)
        if reached is None:
            return None
        T, q, arrived = reached
        return tree.add(T, q, near), arrived

    def _walk(self, T: SE3, q: Array, target: SE3, most: int | None = None) -> tuple[SE3, Array, bool] | None:
        """Where strides straight from T to a pose lead before an arm cannot follow or something touches."""
        metres, radians = T.distance_to(target)
        count = max(int(np.ceil(max(metres / STRIDE, radians / SWING))), 1)
        columns, at, arrived = self.checker.columns, None, False
        for k in range(1, min(count, most or count) + 1):
            pose = target if k == count else T.interpolate(target, k / count)
            new = self.hands.at(pose, q, jump=LEAP)
            if isinstance(new, Stuck) or not self.checker.edge_is_free(q[columns], new[columns], STEP):
                break
            at, q, arrived = pose, new, k == count
            if k % REACH == 0 and self.limits.over:
                break
        return None if at is None else (at, q, arrived)

    def _shortened(self, poses: list[SE3]) -> list[SE3]:
        """With fewer corners: straight ways between places on it, where the joints can follow those."""
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
        """All joints at poses, from q at the first on; None if the way is not free with them."""
        found = [q]
        for a, b in pairwise(poses):
            reached = self._walk(a, found[-1], b)
            if reached is None or not reached[2]:
                return None
            found.append(reached[1])
        return found

    @property
    def looked_at(self) -> int:
        """Poses in both trees."""
        return len(self.ahead.parents) + len(self.back.parents)
