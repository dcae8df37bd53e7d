"""Parameter distributions: map a number in [0, 1) to a parameter value."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Protocol

from armcell.core import InputError, UnknownNameError


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


KINDS = ("uniform", "whole", "log_uniform", "normal", "choice")


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
