"""Search for the nearest collision-free configuration and the nearest reachable pose."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from itertools import islice

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.core import SE3, SO3
from armcell.kinematics import IKSettings, ik_solver
from armcell.scene import PlanningScene

Array = NDArray[np.float64]

Free = Callable[[Array], bool]

RADII = 0.01 * 1.5 ** np.arange(16)  # [rad or m], up to 4.4
DRAWN = 150  # directions per radius
HALVINGS = 8
SEARCH = IKSettings(seeds=60)  # poses that 60 descents do not reach are not useful
SOLUTIONS = 12  # solutions examined per pose


def nearest_free(q: ArrayLike, free: Free, lower: Array, upper: Array, seed: int = 0) -> Array | None:
    """Search for a collision-free configuration (n,) near q by sampling; return None if the search fails.

    The search samples shells of growing radius, first along single joints, and pulls the free samples of
    the first successful shell toward q, first as a whole and then joint by joint.

    Args:
        free: returns whether a configuration (n,) is allowed. lower, upper: limits (n,), infinite if absent.
    """
    at = np.clip(np.asarray(q, dtype=float), lower, upper)
    if free(at):
        return at
    rng, n = np.random.default_rng(seed), len(at)
    for radius in RADII:
        random = rng.normal(size=(DRAWN, n))
        random /= np.linalg.norm(random, axis=1, keepdims=True)
        found = []
        for direction in (*np.eye(n), *-np.eye(n), *random):
            there = np.clip(at + radius * direction, lower, upper)
            if np.any(there != at) and free(there):
                found.append(there)
        if found:
            found.sort(key=lambda p: float(np.linalg.norm(p - at)))
            pulled = [_pulled(at, p, free) for p in found[:8]]
            return min(pulled, key=lambda p: float(np.linalg.norm(p - at)))
    return None


def _pulled(at: Array, p: Array, free: Free) -> Array:
    """Move a collision-free configuration p closer to the configuration `at`: set each joint to its value in
    `at` if p remains collision-free, then bisect between p and `at`.
    """
    for k in np.argsort(np.abs(p - at)):  # small detours first
        only = p.copy()
        only[k] = at[k]
        if free(only):
            p = only
    return _bisected(at, p, free)


def _bisected(bad: Array, good: Array, free: Free) -> Array:
    if free(bad):
        return bad
    for _ in range(HALVINGS):
        middle = (bad + good) / 2
        if free(middle):
            good = middle
        else:
            bad = middle
    return good


# --- poses ---
def _grid() -> Array:
    """Return the 26 unit directions (26, 3) in which to search for the nearest reachable pose: toward the
    faces, edges and corners of a cube.
    """
    steps = np.array(np.meshgrid(*[[0, 1, -1]] * 3, indexing="ij")).reshape(3, -1).T
    steps = steps[np.any(steps != 0, axis=1)].astype(float)
    steps = steps[np.argsort(np.abs(steps).sum(1), kind="stable")]
    return steps / np.linalg.norm(steps, axis=1, keepdims=True)


DIRECTIONS = _grid()
DISTANCES = 0.005 * 2.0 ** np.arange(9.0)  # [m], up to 1.28
ANGLES: Array = np.deg2rad(np.array([5.0, 10.0, 20.0, 40.0, 80.0, 130.0, 180.0]))


class PoseSearch:
    """Search for the nearest reachable pose: the pose closest to a given pose that the robot reaches in a
    collision-free configuration.

    Args:
        free: returns whether a configuration (n,) of the group is allowed.
        until: end of the search [s] of time.monotonic(); the best result until then counts.
    """

    def __init__(
        self, scene: PlanningScene, group: str, link: str | None, free: Free, seed: int, until: float
    ):
        self.scene, self.free, self.seed, self.until = scene, free, seed, until
        self.ik = ik_solver(scene.model, group, link, SEARCH)

    def reached(self, T: SE3) -> Array | None:
        """Return a collision-free configuration (n,) that reaches a pose and is near the scene's joint
        positions. Return None if the search finds no such configuration.
        """
        rng = np.random.default_rng(self.seed)
        some = islice(self.ik.solutions(T, self.scene.positions, rng), SOLUTIONS)
        return next((q for q in some if self.free(q)), None)

    def nearest_position(self, T: SE3, directions: Array = DIRECTIONS) -> tuple[SE3, Array] | None:
        """Find the nearest reachable pose that has the same orientation as an unreachable pose, and a
        configuration that reaches it.
        """
        return self._nearest(directions, DISTANCES, lambda step: SE3(T.rotation, T.translation + step))

    def nearest_orientation(self, T: SE3) -> tuple[SE3, Array] | None:
        """Find the smallest rotation with which an unreachable pose becomes reachable while its position
        stays the same.
        """
        return self._nearest(DIRECTIONS, ANGLES, lambda step: SE3(T.rotation @ SO3.exp(step), T.translation))

    def towards(self, T: SE3, goals: list[Array]) -> tuple[SE3, Array] | None:
        """Find the reachable pose that is nearest to an unreachable pose T.

        The search follows lines from T to the points `goals` (3,).
        """
        best: tuple[float, SE3, Array] | None = None
        for point in goals:
            line = point - T.translation
            size = float(np.linalg.norm(line))
            if size < 1e-9:
                continue
            found = self._nearest(
                (line / size)[None],
                np.linspace(0.0, size, 25)[1:],
                lambda step: SE3(T.rotation, T.translation + step),
            )
            if found is not None and (best is None or T.distance_to(found[0])[0] < best[0]):
                best = (T.distance_to(found[0])[0], *found)
        return best[1:] if best is not None else None

    def _nearest(
        self, directions: Array, sizes: Array, pose: Callable[[Array], SE3]
    ) -> tuple[SE3, Array] | None:
        before = 0.0
        for size in sizes:
            hits = [d for d, q in self._tried(directions, size, pose) if q is not None]
            if hits:
                return self._closer(hits, before, size, pose)
            if time.monotonic() > self.until:
                return None
            before = size
        return None

    def _tried(
        self, directions: Array, size: float, pose: Callable[[Array], SE3]
    ) -> Iterator[tuple[Array, Array | None]]:
        for direction in directions:
            if time.monotonic() > self.until:
                return
            yield direction, self.reached(pose(size * direction))

    def _closer(
        self, directions: list[Array], low: float, high: float, pose: Callable[[Array], SE3]
    ) -> tuple[SE3, Array] | None:
        """Bisect along each direction between an unreachable pose and a reachable one, and return the nearest
        reachable pose.
        """
        best, chosen = np.inf, None
        for direction in directions[:8]:
            a, b = low, min(high, best)
            q = self.reached(pose(b * direction))
            if q is None:  # no better than the best pose found before
                continue
            for _ in range(HALVINGS):
                middle = (a + b) / 2
                found = self.reached(pose(middle * direction))
                if found is None:
                    a = middle
                else:
                    b, q = middle, found
            if b < best:
                best, chosen = b, (pose(b * direction), q)
        return chosen
