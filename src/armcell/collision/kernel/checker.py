"""`KernelChecker`: the kernel behind the same questions as the exact checker."""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from armcell.collision.certificate import Certificate
from armcell.collision.exact import ExactChecker
from armcell.collision.kernel.block import EXACT, PADDED, check
from armcell.collision.kernel.frames import workspace
from armcell.collision.kernel.layout import flatten
from armcell.collision.kernel.motion import free_edge, prove_points
from armcell.collision.kernel.pack import pack
from armcell.scene import PlanningScene

Array = NDArray[np.float64]


class KernelChecker:
    """Collision checks of one scene for the joints of one group, 16 configurations at a time.

    Not thread-safe: it has one workspace. Make one per thread.

    Attributes:
        exact: the exact checker of the same scene, for evidence: pairs, depths, distances.
    """

    def __init__(self, scene: PlanningScene, joint_names: Iterable[str] | None = None):
        names = tuple(joint_names) if joint_names is not None else scene.model.joint_names
        self.scene, self.model, self.joint_names = scene, scene.model, names
        self.columns = np.array(scene.model.columns(names), dtype=np.int64)
        self.pack, self.names = pack(scene, names)
        self.flat = flatten(self.pack)
        self.lanes, self.state, self.scratch = workspace(self.flat)
        self.slack = np.zeros(max(len(self.pack.frame), 1), np.float32)
        self.slack_pair = np.zeros(max(len(self.pack.pairs), 1), np.float32)
        self._exact: ExactChecker | None = None

    @property
    def exact(self) -> ExactChecker:
        if self._exact is None:
            self._exact = ExactChecker(self.scene, self.joint_names)
        return self._exact

    @property
    def arrays(self) -> tuple:
        """What every kernel function takes first: pack, workspace, slack."""
        return (*self.flat, self.lanes, self.state, self.scratch, self.slack, self.slack_pair)

    def relax_margins(self, q: ArrayLike) -> None:
        """Lower the padding of pairs that are closer than it at q, but do not touch (see the exact one)."""
        near = self.exact.relaxed_margins(q)
        if not near:
            return
        for (body, item), margin in near.items():
            for k, b in enumerate(self.names.bodies):
                for o, name in enumerate(self.names.objects):
                    if b == body and name == item and self.pack.margin[k, o] >= 0:
                        self.pack.margin[k, o] = min(self.pack.margin[k, o], margin)
        self.flat = flatten(self.pack)

    def is_free(self, q: ArrayLike) -> bool:
        """Whether nothing that the group can move touches anything (padding included)."""
        return not check(*self.arrays, EXACT | PADDED, np.ascontiguousarray(q, dtype=float))

    def edge_is_free(self, a: ArrayLike, b: ArrayLike, step: float = 0.03) -> bool:
        """Whether a straight motion is free at samples at most `step` [rad] apart."""
        return bool(free_edge(*self.arrays, np.array([a, b], dtype=float), step))

    def certify(
        self, waypoints: ArrayLike, slack: ArrayLike | None = None, padded: bool = False
    ) -> Certificate:
        """Prove a piecewise linear motion (k, n) free. See `certify_path` for the exact checker's own."""
        points = np.ascontiguousarray(waypoints, dtype=float)
        if len(points) == 1:
            points = np.vstack([points, points])
        room = np.zeros(len(self.joint_names)) if slack is None else np.ascontiguousarray(slack, dtype=float)
        at = float(prove_points(*self.arrays, points, room, PADDED if padded else 0))
        if at < 0:
            return Certificate(True)
        # Where and what: the exact checker says it more precisely, from the edge the kernel stopped at.
        i, edges = min(int(at), len(points) - 2), len(points) - 1
        found = self.exact.certify(points[i : i + 2], room)
        if not found.free:
            return Certificate(False, (i + found.at) / edges, found.contact)
        q = points[i] + (at - i) * (points[i + 1] - points[i])
        return Certificate(False, at / edges, self.exact.nearest(q))
