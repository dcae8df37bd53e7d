"""Numeric inverse kinematics for any chain: damped least squares from many seeds."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from armcell.kinematics.ik.chain import Chain, errors_at
from armcell.kinematics.ik.descent import descend
from armcell.kinematics.ik.nullspace import approach_in_null_space
from armcell.kinematics.ik.search import search
from armcell.kinematics.ik.seeds import rank, sampling_range
from armcell.kinematics.ik.solver import POSE_JOINTS, ChainData, IKSettings, IKSolver, ik_solvers

Array = NDArray[np.float64]

TABLED = 64  # maximum number of precomputed seeds, nearest first; the remaining seeds are random
BATCH = 4  # number of solutions per call of the compiled search
POLISH = 12  # iterations that bring an arm with fewer than six joints as near to the goal as it gets
BARREN = 32  # if a solution exists, the search ends after this many seeds without a new one


@ik_solvers.register("numeric")
class NumericIK(IKSolver):
    """Numeric solver for inverse kinematics, which runs damped least squares from many start configurations
    (seeds).

    The seeds are the reference, then the precomputed poses nearest to the goal, then random positions.
    """

    method = "numeric"

    def _search(self, prepared: ChainData, goal: Array, reference: Array, rng: np.random.Generator | None,
                outside: dict[str, int]) -> Iterator[Array]:  # fmt: skip
        chain, s = prepared.chain, self.settings
        if np.linalg.norm(goal[[3, 7, 11]]) > chain.reach + s.position_tolerance:
            return
        found, count, given = np.empty((s.seeds, len(reference))), 0, 0
        for seeds, scores, left in self._seeds(prepared, goal, reference, rng):
            while left > 0:
                tried, count = search(
                    chain.table,
                    chain.bounds,
                    chain.turning,
                    goal,
                    chain.position_weight,
                    reference,
                    seeds,
                    scores,
                    min(left, BARREN),
                    s.max_iterations,
                    s.position_tolerance,
                    s.rotation_tolerance,
                    found,
                    count,
                    given + BATCH,
                )
                left -= tried
                if count == given > 0 and tried == BARREN:
                    return
                for q in found[given:count]:
                    yield self._polished(chain, goal, q) if len(q) < POSE_JOINTS else q.copy()
                given = count

    def _polished(self, chain: Chain, goal: Array, q: Array) -> Array:
        """Refine a numeric IK solution that is within the coarse tolerance. The returned positions (n,) are
        at least as close to the goal pose.
        """
        better = q.copy()
        exact = IKSettings()
        descend(
            chain.table, chain.bounds, goal, chain.position_weight, POLISH, POLISH, exact.position_tolerance,
            exact.rotation_tolerance, better, np.empty((len(chain.table), 6)), np.empty((len(q), 7)),
        )  # fmt: skip
        before, after = (sum(errors_at(chain.table, x, goal)) for x in (q, better))
        return better if after < before else q.copy()

    def _nearer(self, prepared: ChainData, goal: Array, reference: Array, q: Array) -> Array:
        if len(q) <= 6:
            return q
        chain, nearer = prepared.chain, q.copy()
        approach_in_null_space(
            chain.table,
            chain.bounds,
            goal,
            chain.position_weight,
            reference,
            self.settings.position_tolerance,
            self.settings.rotation_tolerance,
            nearer,
        )
        return nearer

    def _seeds(self, prepared: ChainData, goal: Array, reference: Array, rng: np.random.Generator | None):
        """Yield batches (k, n) of start configurations (seeds) for numeric IK, with a score for each seed
        (lower is better) and the number of seeds to try.

        All batches together contain at most `settings.seeds` tries.
        """
        yield reference[None], np.zeros(1, np.float32), 1
        tabled = prepared.seeds
        scores = np.empty(len(tabled.positions), np.float32)
        rank(tabled.poses, goal, prepared.chain.position_weight, scores)
        rest = max(self.settings.seeds - 1, 0)
        yield tabled.positions, scores, min(rest, TABLED)
        rest -= TABLED
        if rest > 0:
            low, high = sampling_range(prepared.chain)
            rng = np.random.default_rng(0) if rng is None else rng
            yield rng.uniform(low, high, (rest, len(low))), np.arange(rest, dtype=np.float32), rest
