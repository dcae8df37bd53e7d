"""Specification of a campaign: the cell, the varied parameters and the stop rules."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from itertools import permutations
from pathlib import Path
from typing import Any

from armcell.campaigns.sampling import Distribution, Uniform, distribution, ends
from armcell.cell import Cell, load
from armcell.cell.value_overrides import split_path, with_values
from armcell.core import InputError, UnknownNameError
from armcell.model.untrusted_files import read_yaml

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
    """Return the distribution of each campaign parameter, keyed by the path of the parameter."""
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
