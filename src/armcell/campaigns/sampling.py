"""Parameter distributions, and reproducible sampling of trial parameters, of a campaign.

A distribution maps a number in [0, 1) to a parameter value. A trial's draw depends only on the seed, the
trial number and, for adaptive sampling, on the results of earlier rounds, not on the workers' speed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from armcell.core import InputError, UnknownNameError

Array = NDArray[np.float64]

BLOCK = 100  # trials per Latin hypercube
ROUND = 50  # trials per round of adaptive sampling, which reads the failures of earlier rounds
NEAR = 0.5  # fraction of a round that is placed near failures
SPREAD = 0.08  # standard deviation of samples near failures, as a fraction of the range
KINDS = ("uniform", "whole", "log_uniform", "normal", "choice")


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
    """Sample a trial's normalized parameters (dimensions,) in [0, 1), either uniformly or near an earlier
    failed trial. Also return whether the sample is near a failed trial.

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


class Distribution(Protocol):
    """Probability distribution of a campaign parameter. The method `at` evaluates the inverse of its
    cumulative distribution function.

    Samplers draw numbers in [0, 1) and pass them to `at`.
    """

    def at(self, u: float) -> Any: ...


@dataclass(frozen=True)
class Uniform:
    """Uniform distribution of a campaign parameter from low to high. The option `whole` restricts it to
    integers, including both ends.
    """

    low: float
    high: float
    whole: bool = False

    def at(self, u: float) -> float | int:
        if self.whole:
            count = int(self.high - self.low) + 1
            return int(self.low) + min(int(u * count), count - 1)  # u * count may be rounded up to count
        return self.low + u * (self.high - self.low)


@dataclass(frozen=True)
class LogUniform:
    """Log-uniform distribution of a campaign parameter: values from 1 to 2 are as likely as values from 2 to
    4.
    """

    low: float
    high: float

    def at(self, u: float) -> float:
        return self.low * (self.high / self.low) ** u


@dataclass(frozen=True)
class Normal:
    """Normal distribution of a campaign parameter, truncated at `cut` standard deviations on each side of the
    mean.
    """

    mean: float
    sd: float
    cut: float = 3.0

    def at(self, u: float) -> float:
        from scipy.stats import truncnorm  # imported late: it takes as long as half of armcell

        return self.mean + self.sd * float(truncnorm.ppf(u, -self.cut, self.cut))


@dataclass(frozen=True)
class Choice:
    """Discrete distribution of a campaign parameter, in which all values are equally likely."""

    values: tuple[Any, ...]

    def at(self, u: float) -> Any:
        return self.values[int(u * len(self.values))]


def ends(found: Distribution) -> list[Any]:
    """Return values for testing a campaign parameter: the minimum and maximum of its distribution,
    and two values in between.

    For a choice, return all values. One of the two inner values is not a round fraction of the range: of the
    range 1 to 3, the other values are all integers.
    """
    if isinstance(found, Choice):
        return list(found.values)
    return [found.at(u) for u in (0.0, 0.37, 0.5, 1.0 - 2.0**-53)]


def distribution(data: Any, place: str) -> Distribution:
    """Parse the distribution of a parameter from a campaign file.

    Forms: `{uniform: [low, high]}` or just `[low, high]`, `{whole: [1, 4]}`, `{log_uniform: [low, high]}`,
    `{normal: [mean, sd]}` or `{normal: [mean, sd, cut]}`, `{choice: [a, b, c]}`.

    Args:
        place: location in the file, for error messages.
    Raises:
        UnknownNameError: unknown kind of distribution.
        InputError: the numbers do not form a valid distribution; the error names the location.
    """
    if isinstance(data, list | tuple):
        data = {"uniform": data}
    if not isinstance(data, dict) or len(data) != 1:
        raise InputError(
            "is no distribution",
            element=place,
            hint=f"write one of {', '.join(KINDS)}: [...], or [low, high]",
        )
    kind, given = next(iter(data.items()))
    if kind not in KINDS:
        raise UnknownNameError("distribution", kind, KINDS, element=place)
    if not isinstance(given, list | tuple) or not given:
        raise InputError(f"{kind} needs a list that is not empty", element=place)
    if kind == "choice":
        return Choice(tuple(given))
    numbers = [_number(value, kind, place) for value in given]
    if kind == "normal":
        if len(numbers) not in (2, 3) or numbers[1] < 0 or (len(numbers) == 3 and numbers[2] <= 0):
            raise InputError(
                "normal needs [mean, standard deviation] and perhaps where it is cut off [deviations], "
                "the deviation not negative",
                element=place,
            )
        return Normal(numbers[0], numbers[1], *numbers[2:])
    if len(numbers) != 2 or numbers[0] > numbers[1]:
        raise InputError(f"{kind} needs [low, high], low first; it is {list(given)}", element=place)
    if kind == "log_uniform":
        if numbers[0] <= 0:
            raise InputError("log_uniform needs positive numbers", element=place)
        return LogUniform(numbers[0], numbers[1])
    if kind == "whole":
        if any(n != int(n) for n in numbers):
            raise InputError("whole needs whole numbers", element=place)
        return Uniform(int(numbers[0]), int(numbers[1]), whole=True)
    return Uniform(numbers[0], numbers[1])


def _number(value: Any, kind: str, place: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"{kind} has {value!r}, which is no finite number", element=place)
    return float(value)
