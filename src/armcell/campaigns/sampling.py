"""Which values each trial gets. A trial's draw depends on the seed, its number and, where sampling adapts,
on how the trials of earlier rounds went; never on which worker was quicker."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

BLOCK = 100  # trials that a Latin hypercube spreads evenly
ROUND = 50  # trials between which adaptive sampling looks at what failed
NEAR = 0.5  # share of a round that goes near failures
SPREAD = 0.08  # standard deviation of those, in shares of a parameter's range


def random_draw(seed: int, number: int, dimensions: int) -> Array:
    """(dimensions,) independent numbers in [0, 1)."""
    return np.random.default_rng([seed, number]).random(dimensions)


def latin_hypercube_draw(seed: int, number: int, dimensions: int) -> Array:
    """(dimensions,) of a design in which every hundredth of every range is met once in a block of trials.

    McKay, Beckman, Conover (1979), A Comparison of Three Methods for Selecting Values of Input Variables.
    """
    rng = np.random.default_rng([seed, number // BLOCK, 1])
    cells = np.array([rng.permutation(BLOCK)[number % BLOCK] for _ in range(dimensions)], float)
    return (cells + random_draw(seed, number, dimensions)) / BLOCK


def adaptive_draw(seed: int, number: int, failed: Sequence[Array], dimensions: int) -> tuple[Array, bool]:
    """(dimensions,) and whether it was put near a failure.

    Args:
        failed: the draws of earlier rounds' trials that failed.
    """
    rng = np.random.default_rng([seed, number, 2])
    if not failed or rng.random() >= NEAR:
        return random_draw(seed, number, dimensions), False
    near = failed[int(rng.integers(len(failed)))] + SPREAD * rng.standard_normal(dimensions)
    near = np.abs(near)  # back from the lower end, and from the upper one
    near = np.where(near >= 1, 2 - near, near)
    return np.clip(near, 0.0, 1.0 - 2.0**-53), True
