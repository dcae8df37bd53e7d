"""Parameters of planners, by the planners' own names."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any

from armcell.core import InputError, UnknownNameError
from armcell.core.checks import settings_from

MakeSettings = Callable[[Mapping[str, Any]], Any]


class UnknownParameterError(UnknownNameError):
    """A parameter that a planner does not have; lists those it has, with their present values."""

    def __init__(self, planner: str, name: object, present: Mapping[str, Any]):
        self.kind, self.name, self.known = f"parameter of planner {planner!r}", name, sorted(present)
        near = difflib.get_close_matches(str(name), self.known, n=1, cutoff=0.6)
        has = ", ".join(f"{key} = {present[key]}" for key in self.known) or "none"
        InputError.__init__(
            self,
            f"unknown {self.kind} {str(name)!r}; it has: {has}",
            cure=f"did you mean {near[0]!r}?" if near else None,
        )


def settings_of(planner: str, cls: type) -> MakeSettings:
    """Makes a settings dataclass of a planner from parameters, or raises.

    Raises:
        UnknownParameterError: no such parameter. InputError: a value of the wrong type.
    """

    def make(parameters: Mapping[str, Any]) -> Any:
        present = {f.name: f.default for f in fields(cls)}
        for name in parameters:
            if name not in present:
                raise UnknownParameterError(planner, name, present)
        settings = settings_from(cls, parameters, f"planner {planner}")
        for f in fields(cls):
            value = getattr(settings, f.name)
            if value is not None and value <= 0:
                raise InputError(
                    f"parameter {f.name!r} of planner {planner!r} is {value}, it must be positive"
                )
        return settings

    make.defaults = lambda: {f.name: f.default for f in fields(cls)}  # type: ignore[attr-defined]
    return make
