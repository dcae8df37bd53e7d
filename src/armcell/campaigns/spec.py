"""Specification of a campaign: cell, stop rules, varied parameters, and the sampling of their values.

A distribution maps a number in [0, 1) to a parameter value. A trial's draw depends only on the seed, the
trial number and, for adaptive sampling, on the results of earlier rounds, not on the workers' speed.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import permutations
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from armcell.cell import Cell, load
from armcell.cell.value_overrides import split_path, with_values
from armcell.core import InputError, UnknownNameError
from armcell.model.untrusted_files import read_yaml

Array = NDArray[np.float64]

BLOCK = 100  # trials per Latin hypercube

ROUND = 50  # trials per round of adaptive sampling, which reads the failures of earlier rounds

NEAR = 0.5  # fraction of a round that is placed near failures

SPREAD = 0.08  # standard deviation of samples near failures, as a fraction of the range

KINDS = ("uniform", "whole", "log_uniform", "normal", "choice")


def random_draw(seed: int, number: int, dimensions: int) -> Array:
    """Sample the parameters of a trial for a campaign specification with random sampling: independent uniform
    numbers (dimensions,) in [0, 1).
    """
    return np.random.default_rng([seed, number]).random(dimensions)


def latin_hypercube_draw(seed: int, number: int, dimensions: int) -> Array:
    """Sample the parameters of a trial for a campaign specification with Latin hypercube sampling: a point
    (dimensions,) of the hypercube in [0, 1).

    In each block of 100 trials, every hundredth of every parameter range occurs exactly once.

    McKay, Beckman, Conover (1979), A Comparison of Three Methods for Selecting Values of Input Variables.
    """
    rng = np.random.default_rng([seed, number // BLOCK, 1])
    cells = np.array([rng.permutation(BLOCK)[number % BLOCK] for _ in range(dimensions)], float)
    return (cells + random_draw(seed, number, dimensions)) / BLOCK


def adaptive_draw(seed: int, number: int, failed: Sequence[Array], dimensions: int) -> tuple[Array, bool]:
    """Sample the parameters of a trial for a campaign specification with adaptive sampling: numbers
    (dimensions,) in [0, 1), uniform or near an earlier failed trial. Also return whether they are near a
    failed trial.

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
    """Probability distribution of a parameter in a campaign specification. The method `at` evaluates the
    inverse of its cumulative distribution function.

    Samplers draw numbers in [0, 1) and pass them to `at`.
    """

    def at(self, u: float) -> Any: ...


@dataclass(frozen=True)
class Uniform:
    """Uniform distribution of a parameter in a campaign specification, from low to high. The option `whole`
    restricts it to integers, including both ends.
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
    """Log-uniform distribution of a parameter in a campaign specification: values from 1 to 2 are as likely
    as values from 2 to 4.
    """

    low: float
    high: float

    def at(self, u: float) -> float:
        return self.low * (self.high / self.low) ** u


@dataclass(frozen=True)
class Normal:
    """Normal distribution of a parameter in a campaign specification, truncated at `cut` standard deviations
    on each side of the mean.
    """

    mean: float
    sd: float
    cut: float = 3.0

    def at(self, u: float) -> float:
        from scipy.stats import truncnorm  # imported late: it takes as long as half of armcell

        return self.mean + self.sd * float(truncnorm.ppf(u, -self.cut, self.cut))


@dataclass(frozen=True)
class Choice:
    """Discrete distribution of a parameter in a campaign specification, in which all values are equally
    likely.
    """

    values: tuple[Any, ...]

    def at(self, u: float) -> Any:
        return self.values[int(u * len(self.values))]


def ends(found: Distribution) -> list[Any]:
    """Return test values for a parameter in a campaign specification: the minimum and maximum of its
    distribution, and two values in between.

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


SAMPLINGS = ("random", "latin_hypercube", "adaptive")

KEYS = (
    "cell", "parameters", "values", "sampling", "seed", "trials", "max_seconds", "half_width",
    "trial_seconds",
)  # fmt: skip


@dataclass(frozen=True)
class CampaignSpec:
    """Specification of a campaign, which is read from a file or created in Python.

    Attributes:
        cell: built-in name, folder or file.
        parameters: distributions of the varied parameters, by path in the cell file, in the syntax of the
            campaign file. In addition, every trial draws the cell's own `randomize` entries with its seed.
        values: fixed values that replace those of the cell file in all trials, by path.
        sampling: sampling method of the parameters; see `sampling`.
        seed: seed of the first trial; each further trial adds 1.
        trials: maximum number of trials.
        max_seconds: stop after this wall time [s]. None: no limit.
        half_width: stop when the 95 % interval of the success rate is this narrow, to each side. None: off.
        trial_seconds: time limit of a trial [s]; a longer trial is ended and counts as failed.
    """

    cell: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    values: Mapping[str, Any] = field(default_factory=dict)
    sampling: str = "random"
    seed: int = 0
    trials: int = 100
    max_seconds: float | None = None
    half_width: float | None = None
    trial_seconds: float = 600.0

    def __post_init__(self) -> None:
        if self.sampling not in SAMPLINGS:
            raise UnknownNameError("sampling", self.sampling, SAMPLINGS)
        for name, least in (("trials", 1), ("seed", 0)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or value < least:
                raise InputError(f"{name} is {value!r}", hint=f"give a whole number, at least {least}")
        for name in ("max_seconds", "half_width", "trial_seconds"):
            value = getattr(self, name)
            if value is None and name != "trial_seconds":
                continue
            if isinstance(value, bool) or not isinstance(value, int | float) or not value > 0:
                raise InputError(f"{name} is {value!r}", hint="give a positive number")
        if self.half_width is not None and self.half_width >= 0.5:
            raise InputError(f"half_width is {self.half_width:g}", hint="give a share below 0.5, e.g. 0.01")
        for name in ("parameters", "values"):
            given = getattr(self, name)
            if not isinstance(given, Mapping) or not all(isinstance(path, str) for path in given):
                raise InputError(
                    f"{name} is not a mapping from paths", hint="e.g. {objects.cube.mass: [0.1, 1]}"
                )
        self._check_places()
        distributions(self)  # raises errors of the distributions early

    def _check_places(self) -> None:
        """Reject a campaign specification in which two paths set the same value,
        or one path sets a part of the other's value.

        A parameter may vary a part of a fixed value, e.g. the force of a push.
        """
        both = set(self.parameters) & set(self.values)
        if both:
            raise InputError(f"{', '.join(sorted(both))}: in parameters and in values; give one or the other")
        for outer, inner in permutations((*self.values, *self.parameters), 2):
            place, within = split_path(outer), split_path(inner)
            part_varies = outer in self.values and inner in self.parameters and within != place
            if within[: len(place)] == place and not part_varies:
                how = "the same as" if within == place else "a part of"
                raise InputError(f"{inner} is {how} {outer}", hint="give one or the other")

    @staticmethod
    def read(file: str | Path) -> CampaignSpec:
        """Read the specification of a campaign from a YAML file. A relative path in `cell` is relative to
        that file.

        Raises:
            InputError: the file is invalid; the error names the file and the cause.
        """
        path = Path(file)
        data = read_yaml(path)
        for key in data:
            if key not in KEYS:
                raise UnknownNameError("key", key, KEYS, file=path)
        if not isinstance(data.get("cell"), str):
            raise InputError("has no cell", file=path, hint="cell: panda_pick")
        beside = path.parent / data["cell"]
        if os.path.exists(beside):
            data["cell"] = str(beside)
        try:
            return CampaignSpec(**data)
        except InputError as error:
            raise InputError(error.reason, file=path, element=error.element, hint=error.hint) from None

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


def distributions(spec: CampaignSpec) -> dict[str, Distribution]:
    """Return the distribution that a campaign specification gives for each parameter, keyed by the
    parameter's path.
    """
    return {path: distribution(data, f"parameters/{path}") for path, data in spec.parameters.items()}


def checked_cell(spec: CampaignSpec) -> Cell:
    """Check a campaign specification: load its cell, test the cell with the extreme values of all parameters,
    and return the cell.

    Raises:
        UnknownNameError: the cell has no such parameter.
        InputError: a value is not allowed, e.g. a negative mass, or the cell has no task.
    """
    cell = with_values(load(spec.cell), spec.values)
    if not cell.spec.task and cell.spec.script is None:
        hint = "add 'task: [...]' or 'script: task.py'"
        raise InputError("the cell has no task", file=cell.file, hint=hint)
    for path, found in distributions(spec).items():
        for value in ends(found):
            try:
                with_values(cell, {path: value}).scene(spec.seed)
            except UnknownNameError:
                raise
            except InputError as error:
                raise _with_hint(error, cell, path, found, value) from None
    return cell


def _with_hint(error: InputError, cell: Cell, path: str, found: Distribution, value: Any) -> InputError:
    """Return an error about a parameter in a campaign specification.
    If an integer would be valid, the error contains a hint.
    """
    if not isinstance(found, Uniform) or found.whole or float(value).is_integer():
        return error
    try:
        with_values(cell, {path: round(value)})
    except InputError:
        return error
    low, high = math.ceil(found.low), math.floor(found.high)
    hint = f"parameters: {{{path}: {{whole: [{low}, {high}]}}}}" if low <= high else "give a whole number"
    return InputError(error.reason, file=error.file, element=error.element, hint=hint)
