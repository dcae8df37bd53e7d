"""`KernelChecker`: fast collision checks and certification like those of `ExactChecker`."""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.collision.certify import Certificate
from armcell.collision.exact_checker import ExactChecker
from armcell.collision.kernel.block import EXACT, PADDED, handle_of, touches
from armcell.collision.kernel.lru_cache import LruCache
from armcell.collision.kernel.motion import check_edge, prove_points, proven_clearance
from armcell.collision.kernel.pack import PAIR_MARGIN, Flat, Names, Pack, flatten, pack
from armcell.collision.kernel.robot_arrays import robot_part
from armcell.collision.kernel.workspace import workspace
from armcell.collision.kernel.world_arrays import world_of
from armcell.core.checks import float_array, require
from armcell.scene import PlanningScene

Array = NDArray[np.float64]


_packs: LruCache[tuple[Pack, Names, Flat]] = LruCache(8)


def _packed(scene: PlanningScene, joint_names: tuple[str, ...]) -> tuple[Pack, Names, Flat]:
    """Return the arrays that the kernel checker needs for a scene; those of the most recent scenes are
    cached.

    Planning again with only the group's joints at other positions costs no time.
    """
    robot, world = robot_part(scene, joint_names), world_of(scene.objects)

    def make() -> tuple[Pack, Names, Flat]:
        packed, names = pack(scene, robot, world)
        return packed, names, flatten(packed)

    key = (robot, world, frozenset(scene.allowed.items()))
    return _packs.get(key, make)


class KernelChecker:
    """Fast collision checker for one scene and one joint group, whose SIMD kernel checks 16 configurations at
    a time.

    The checker has one workspace and is not thread-safe: create one per thread.

    Attributes:
        exact: the exact checker of the same scene, for evidence: pairs, depths, distances.
    """

    def __init__(self, scene: PlanningScene, joint_names: Iterable[str] | None = None):
        names = tuple(joint_names) if joint_names is not None else scene.model.joint_names
        self.scene, self.model, self.joint_names = scene, scene.model, names
        self.columns = np.array(scene.model.columns(names), dtype=np.int64)
        self.pack, self.names, self.flat = _packed(scene, names)
        self.lanes, self.state, self.scratch = workspace(self.flat)
        self.slack = np.zeros(max(len(self.pack.frame), 1), np.float32)
        self.slack_pair = np.zeros(max(len(self.pack.pairs), 1), np.float32)
        self.without_arm_clearance: KernelChecker | None = None  # the checker before `with_clearance_between`
        self._exact: ExactChecker | None = None
        self._take_hold()

    def __reduce__(self) -> tuple:
        """Pickle or copy the checker as its scene, from which the checker is rebuilt.

        The handle contains memory addresses, which are invalid in a copy.
        """
        return KernelChecker, (self.scene, self.joint_names)

    @property
    def exact(self) -> ExactChecker:
        if self._exact is None:
            self._exact = ExactChecker(self.scene, self.joint_names)
        return self._exact

    def _take_hold(self) -> None:
        """Create the handle to the kernel checker's arrays, which every kernel function takes as its first
        argument.
        """
        self.handle = handle_of(
            (*self.flat, self.lanes, self.state, self.scratch, self.slack, self.slack_pair)
        )

    def relax_margins(self, q: ArrayLike) -> None:
        """Reduce the kernel checker's padding for each body that is closer to an object at q (n,) than the
        padding. The new padding is just below the current distance.

        See `ExactChecker.relax_margins`.
        """
        if self.is_free(q):
            return
        near = self.exact.relaxed_margins(q)
        margins = self.pack.margin.copy()
        for (body, item), margin in near.items():
            for k, b in enumerate(self.names.bodies):
                for o, name in enumerate(self.names.objects):
                    if b == body and name == item and self.pack.margin[k, o] >= 0:
                        margins[k, o] = min(margins[k, o], margin)
        self.pack = self.pack._replace(margin=margins)
        self.flat = flatten(self.pack)
        self._take_hold()

    def with_clearance_between(self, sides: Mapping[str, int], distance: float) -> KernelChecker:
        """Return a copy of the kernel checker that also requires a clearance [m] between two arms or other
        sets of bodies. `sides` assigns each body to a set.

        Args:
            sides: side of each body (link or attached object) by name; bodies without a side have no
                clearance.
            distance: clearance between bodies of different sides [m].
        """
        side = np.array([sides.get(name, -1) for name in self.names.bodies])
        a, b = side[self.pack.pairs[:, 0]], side[self.pack.pairs[:, 1]]
        margins = np.where((a >= 0) & (b >= 0) & (a != b), np.float32(distance), np.float32(0.0))
        other = KernelChecker(self.scene, self.joint_names)
        other.pack = self.pack._replace(pair_margin=margins)
        ints, floats, doubles = self.flat
        floats = floats.copy()
        floats[ints[PAIR_MARGIN] :][: len(margins)] = margins
        other.flat, other.without_arm_clearance = (ints, floats, doubles), self
        other._take_hold()
        return other

    def is_free(self, q: ArrayLike) -> bool:
        """Check with the kernel checker that no body that the group moves touches another body. The check
        includes padding.
        """
        return not touches(self.handle, EXACT | PADDED, self._configuration(q))

    def touches(self, q: ArrayLike) -> bool:
        """Check with the kernel checker whether any two bodies are in contact. The check ignores padding."""
        return bool(touches(self.handle, EXACT, self._configuration(q)))

    def _configuration(self, q: ArrayLike) -> Array:
        """Validate a configuration (n,) and return it as a contiguous array for the kernel checker.

        The kernel would read past the end of a shorter array and treat NaN as collision-free.
        """
        if type(q) is not np.ndarray or q.shape != self.columns.shape or not math.isfinite(sum(q.tolist())):
            q = float_array(q, self.columns.shape, "a configuration")
        return np.ascontiguousarray(q, dtype=float)

    def _path(self, waypoints: ArrayLike) -> Array:
        points = float_array(waypoints, (None, len(self.columns)), "waypoints")
        require(len(points) > 0, "a motion has at least one waypoint")
        return np.ascontiguousarray(points if len(points) > 1 else np.vstack([points, points]))

    def clearance(self, waypoints: ArrayLike, most: float = 0.25, tolerance: float = 5e-4) -> float:
        """Return a clearance [m] that the kernel checker can prove along a piecewise linear motion (k, n).

        Parts of neighboring links that cannot meet at any joint positions are ignored, however near they are.
        The clearance of `with_clearance_between` is ignored, too.

        Args:
            waypoints: (k, n) joint positions.
            most: upper limit of the result [m].
            tolerance: approximate largest difference [m] by which the result is below the true minimum
                distance; the result is never above the true minimum.
        """
        if self.without_arm_clearance is not None:
            return self.without_arm_clearance.clearance(waypoints, most, tolerance)
        points = self._path(waypoints)
        return float(proven_clearance(self.handle, points, most, tolerance))

    def edge_is_free(self, a: ArrayLike, b: ArrayLike, step: float = 0.03) -> bool:
        """Check a straight motion for collisions with the kernel checker, at samples at most `step` [rad]
        apart.
        """
        return bool(check_edge(self.handle, self._path(np.stack([np.asarray(a), np.asarray(b)])), step))

    def certify(
        self,
        waypoints: ArrayLike,
        slack: ArrayLike | None = None,
        padded: bool = False,
        *,
        distance: float = 0.0,
        evidence: bool = True,
    ) -> Certificate:
        """Certify with the kernel checker that a piecewise linear motion (k, n) is collision-free.

        Args:
            waypoints: (k, n) joint positions.
            slack: (n,) largest deviation of each joint from the straight edges [rad or m].
            padded: also keep the padding.
            distance: distance that all pairs must keep [m]; the evidence is about contact only.
            evidence: if the certification fails, find the pair in contact (takes milliseconds).
        """
        points, n = self._path(waypoints), len(self.columns)
        room = np.zeros(n) if slack is None else np.ascontiguousarray(float_array(slack, (n,), "slack"))
        at = float(prove_points(self.handle, points, room, float(distance), PADDED if padded else 0))
        if at < 0:
            return Certificate(True)
        i, edges = min(int(at), len(points) - 2), len(points) - 1
        if not evidence:
            return Certificate(False, at / edges)
        # The exact checker finds position and pair more precisely, from the edge where the kernel stopped.
        found = self.exact.certify(points[i : i + 2], room)
        if not found.free:
            return Certificate(False, (i + found.at) / edges, found.contact)
        q = points[i] + (at - i) * (points[i + 1] - points[i])
        return Certificate(False, at / edges, self.exact.nearest(q))
