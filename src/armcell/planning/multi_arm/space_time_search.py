"""Search in joint positions and time for a path past the future motion of another arm.

Two trees of (position, time) grow toward each other: forward from the start, and backward from arrivals at
the goals at various times. An edge is a straight motion at constant speed within all joint speed limits
(Grothe, Hartmann, Orthey and Toussaint, "ST-RRT*: asymptotically-optimal bidirectional motion planning
through space-time", ICRA 2022). The arm may therefore wait, slow down, step aside or take another path.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

REACH = 0.7  # [rad] longest edge while trees grow
WAIT_SHARE = 0.15  # share of samples that reuse a position of the tree at another time
TIME_WEIGHT = 0.3  # [rad/s] of a second in the distance of two nodes
SHORTCUTS = 150


class EdgeValidity(Protocol):
    """Interface (`typing.Protocol`) of the validity check for edges of the space-time search. An edge is a
    straight motion from positions p (n,) at time s [s] to q (n,) at time t [s].
    """

    def free(self, p: Array, s: float, q: Array, t: float) -> bool: ...


@dataclass(frozen=True, eq=False)
class SpaceTimeProblem:
    """Problem of a search in space and time: a start (n,) at a given time, and goals (g, n). Each goal has an
    earliest time [s] at which the arm may come to rest there.
    """

    validity: EdgeValidity
    start: Array
    start_time: float
    goals: Array
    goals_from: Array  # (g,) [s] earliest time of rest at each goal
    speed: Array  # (n,) [rad/s] speed limit of each joint
    lower: Array
    upper: Array

    def quickest(self, p: Array, q: Array) -> float:
        """Return the shortest time [s] in which the arm can move between two joint positions, for the search
        in space and time.
        """
        return float(np.max(np.abs(q - p) / self.speed))

    def arrival(self, goal: int) -> float:
        """Return the earliest time [s] at which the arm can arrive at a goal, for the search in space and
        time.
        """
        return max(
            self.start_time + self.quickest(self.start, self.goals[goal]), float(self.goals_from[goal])
        )


@dataclass(frozen=True, eq=False)
class SpaceTimePath:
    """Path in space and time: joint positions (k, n) at times (k,) [s], with constant speed between them.

    `nodes` is the number of nodes in both search trees.
    """

    points: Array
    times: Array
    nodes: int = 0


class _Tree:
    """Tree for a search in space and time, with nodes (q, t) and their parents. It grows into the future if
    its sign is 1, and into the past if its sign is -1.
    """

    def __init__(self, dof: int, sign: int):
        self.q, self.t = np.empty((256, dof)), np.empty(256)
        self.parent: list[int] = []
        self.sign = sign

    def __len__(self) -> int:
        return len(self.parent)

    def add(self, q: Array, t: float, parent: int) -> int:
        n = len(self)
        if n == len(self.t):
            self.q = np.vstack([self.q, np.empty_like(self.q)])
            self.t = np.concatenate([self.t, np.empty_like(self.t)])
        self.q[n], self.t[n] = q, t
        self.parent.append(parent)
        return n

    def nearest(self, q: Array, t: float, speed: Array) -> int:
        """Return the tree node nearest in space and time from which (q, t) can be reached without exceeding
        the speed limits, or -1.
        """
        n = len(self)
        gap = self.sign * (t - self.t[:n])
        away = np.abs(self.q[:n] - q)
        reachable = np.max(away / speed, axis=1) <= gap + 1e-9
        if not reachable.any():
            return -1
        distance = np.sqrt(np.sum(away**2, axis=1)) + TIME_WEIGHT * gap
        distance[~reachable] = np.inf
        return int(np.argmin(distance))

    def branch(self, node: int) -> Iterator[tuple[Array, float]]:
        while node >= 0:
            yield self.q[node].copy(), float(self.t[node])
            node = self.parent[node]


def search(
    problem: SpaceTimeProblem,
    horizon: float,
    rng: np.random.Generator,
    deadline: float,
    iterations: int = 30_000,
) -> SpaceTimePath | None:
    """Search in space and time for a path that arrives before `horizon` [s]. Return None if none was found.

    Args:
        deadline: [s] of time.monotonic(). iterations: each grows one tree and then connects the other.
    """
    dof = len(problem.start)
    usable = [g for g in range(len(problem.goals)) if problem.arrival(g) < horizon]
    if not usable:
        return None
    ahead, back = _Tree(dof, 1), _Tree(dof, -1)
    ahead.add(problem.start, problem.start_time, -1)
    for g in usable:
        back.add(problem.goals[g], problem.arrival(g), -1)
    grown, other = ahead, back
    for _ in range(iterations):
        if time.monotonic() > deadline:
            break
        if rng.random() < 0.1:  # add another arrival time
            g = usable[int(rng.integers(len(usable)))]
            t = rng.uniform(problem.arrival(g), horizon)
            if problem.validity.free(problem.goals[g], t, problem.goals[g], t):
                back.add(problem.goals[g], t, -1)
        q, t = _sample(problem, grown, horizon, rng)
        end = _extend(problem, grown, q, t)
        if end >= 0:
            at_q, at_t = grown.q[end].copy(), float(grown.t[end])
            while True:
                reached = _extend(problem, other, at_q, at_t)
                if reached < 0:
                    break
                if other.t[reached] == at_t and np.array_equal(other.q[reached], at_q):
                    return _joined(problem, ahead, back, end, reached, grown is ahead)
        grown, other = other, grown
    return None


def _sample(problem: SpaceTimeProblem, tree: _Tree, horizon: float, rng: np.random.Generator):
    if rng.random() < WAIT_SHARE:
        q = tree.q[int(rng.integers(len(tree)))].copy()
    else:
        q = rng.uniform(problem.lower, problem.upper)
    earliest = problem.start_time + problem.quickest(problem.start, q)
    latest = horizon - min(problem.quickest(q, g) for g in problem.goals)
    if earliest >= latest:  # too far to be useful: move it toward the start
        share = rng.random()
        q = problem.start + 0.5 * share * (q - problem.start)
        earliest = problem.start_time + problem.quickest(problem.start, q)
        latest = max(horizon - min(problem.quickest(q, g) for g in problem.goals), earliest + 1e-3)
    return q, float(rng.uniform(earliest, latest))


def _extend(problem: SpaceTimeProblem, tree: _Tree, q: Array, t: float) -> int:
    """Extend a tree of the search in space and time by an edge toward (q, t): joint positions q at time t.
    Return the new node, or -1 on failure.
    """
    node = tree.nearest(q, t, problem.speed)
    if node < 0:
        return -1
    p, s = tree.q[node], float(tree.t[node])
    length = float(np.linalg.norm(q - p))
    share = min(1.0, REACH / length) if length > 0 else 1.0
    if abs(t - s) * share > 1.5:  # [s] long waits are taken in pieces as well
        share = 1.5 / abs(t - s)
    if share < 1.0:
        q, t = p + share * (q - p), s + share * (t - s)
    if t == s:
        return node if np.array_equal(p, q) else -1
    a, b = ((p, s), (q, t)) if tree.sign > 0 else ((q, t), (p, s))
    if not problem.validity.free(*a, *b):
        return -1
    return tree.add(q, t, node)


def _joined(problem, ahead: _Tree, back: _Tree, end: int, reached: int, from_ahead: bool) -> SpaceTimePath:
    first, last = (end, reached) if from_ahead else (reached, end)
    there = list(ahead.branch(first))[::-1]
    onwards = list(back.branch(last))[1:]
    points, times = zip(*(there + onwards), strict=True)
    return SpaceTimePath(np.array(points), np.array(times), len(ahead) + len(back))


def shortened(
    problem: SpaceTimeProblem, path: SpaceTimePath, rng: np.random.Generator, deadline: float
) -> SpaceTimePath:
    """Shorten a space-time path: remove waypoints where a direct edge is valid, and move to the goal earlier
    if possible.
    """
    points, times = list(path.points), list(path.times)
    for _ in range(SHORTCUTS):
        if len(points) < 3 or time.monotonic() > deadline:
            break
        i, j = sorted(int(k) for k in rng.choice(len(points), 2, replace=False))
        if j - i > 1 and problem.validity.free(points[i], times[i], points[j], times[j]):
            del points[i + 1 : j], times[i + 1 : j]
    goal = points[-1]
    known = [g for g in range(len(problem.goals)) if np.array_equal(problem.goals[g], goal)]
    earliest = float(problem.goals_from[known[0]]) if known else times[-1]
    for i in range(len(points) - 1):  # straight to the goal from the earliest possible point
        t = max(times[i] + problem.quickest(points[i], goal), earliest)
        if t < times[-1] - 1e-6 and problem.validity.free(points[i], times[i], goal, t):
            points[i + 1 :], times[i + 1 :] = [goal], [t]
            break
    return SpaceTimePath(np.array(points), np.array(times), path.nodes)
