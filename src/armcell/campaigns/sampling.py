"""Sampling of trial parameters, reproducible and independent of the workers' speed.

A trial's draw depends only on the seed, the trial number and, for adaptive sampling, on the results of
earlier rounds.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

BLOCK = 100  # trials per Latin hypercube
ROUND = 50  # trials per round of adaptive sampling, which reads the failures of earlier rounds
NEAR = 0.5  # fraction of a round that is placed near failures
SPREAD = 0.08  # standard deviation of samples near failures, as a fraction of the range


def random_draw(seed: int, number: int, dimensions: int) -> Array:
    """Sample the parameters of a trial as independent uniform numbers in [0, 1), with shape (dimensions,)."""
    return np.random.default_rng([seed, number]).random(dimensions)


def latin_hypercube_draw(seed: int, number: int, dimensions: int) -> Array:
    """Sample the parameters of a trial as a point (dimensions,) of a Latin hypercube in [0, 1).

    In each block of 100 trials, every hundredth of every parameter range occurs exactly once.

    McKay, Beckman, Conover (1979), A Comparison of Three Methods for Selecting Values of Input Variables.
    """
    rng = np.random.default_rng([seed, number // BLOCK, 1])
    cells = np.array([rng.permutation(BLOCK)[number % BLOCK] for _ in range(dimensions)], float)
    return (cells + random_draw(seed, number, dimensions)) / BLOCK


def adaptive_draw(seed: int, number: int, failed: Sequence[Array], dimensions: int) -> tuple[Array, bool]:
    """Sample the parameters (dimensions,) of a trial in [0, 1).
    Also return whether the sample was placed near an earlier failure.

    Args:
        failed: draws of the failed trials of earlier rounds.
    """
    rng = np.random.default_rng([seed, number, 2])
    if not failed or rng.random() >= NEAR:
        return random_draw(seed, number, dimensions), False
    near = failed[int(rng.integers(len(failed)))] + SPREAD * rng.standard_normal(dimensions)
    near = np.abs(near)  # reflect at both ends of [0, 1)
    near = np.where(near >= 1, 2 - near, near)
    return np.clip(near, 0.0, 1.0 - 2.0**-53), True
