"""Results show themselves in one line."""

from __future__ import annotations

import pkgutil
from collections.abc import Iterator
from importlib import import_module

import numpy as np

import armcell
from armcell.core import ErrorCode, Outcome


def kinds(kind: type[Outcome] = Outcome) -> Iterator[type[Outcome]]:
    yield kind
    for other in kind.__subclasses__():
        yield from kinds(other)


def test_a_result_is_one_line():
    evidence = {"path": np.zeros((100, 7))}
    assert repr(Outcome(ErrorCode.SUCCESS, evidence=evidence)) == "<Outcome SUCCESS>"
    failed = Outcome(ErrorCode.NO_IK_SOLUTION, "too far away\nby 2 m", evidence)
    assert repr(failed) == "<Outcome NO_IK_SOLUTION: too far away by 2 m>"


def test_every_kind_of_result_does_so():
    for package in ("planning", "tasks", "perception", "execution"):
        for module in pkgutil.walk_packages([f"{armcell.__path__[0]}/{package}"], f"armcell.{package}."):
            if not module.name.endswith(("ompl", "trees")):
                import_module(module.name)
    found = list(kinds())
    assert len(found) > 8 and all(kind.__repr__ is Outcome.__repr__ for kind in found), found
