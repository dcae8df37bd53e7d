"""Sizes of tests that repeat one check: few repetitions in `make test`, many in `make test-long`."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest

ROBOTS = ("panda", "ur10", "dual_ur10", "scara", "palletizer", "mobile_ur10", "parallel_gripper")
"""One robot of each kind, for the marker `cases` of tests that have every robot of the library as a case."""


def _param(value: Any, **more: Any) -> Any:
    return pytest.param(*(value if isinstance(value, tuple) else (value,)), **more)


def sizes(few: Any, many: Any) -> list[Any]:
    """Return two values for `pytest.mark.parametrize`; the second one has the marker `long`."""
    return [_param(few, id="few"), _param(many, id="many", marks=pytest.mark.long)]


def seeds(few: int, every: Iterable[Any]) -> list[Any]:
    """Return values for `pytest.mark.parametrize`; those after the first `few` have the marker `long`."""
    return [_param(seed, marks=() if k < few else pytest.mark.long) for k, seed in enumerate(every)]
