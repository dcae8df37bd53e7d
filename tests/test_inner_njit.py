"""Inner functions are linked into compiled callers and cannot be called from Python."""

from __future__ import annotations

import pytest
from numba import njit

from armcell._inner_njit import inner_njit


@inner_njit
def _square(x):
    return x * x


@inner_njit(forceinline=True)
def _sum_of_squares(x, y):
    return _square(x) + _square(y)


@njit
def _norm(x, y):
    return _sum_of_squares(x, y) ** 0.5


@njit
def _hundredfold(x):
    return 100 * _square(x)


def test_compiled_functions_call_inner_functions_of_every_type():
    assert _norm(3.0, 4.0) == 5.0
    assert _norm(6, 8) == 10.0
    assert _hundredfold(2) == 400 and isinstance(_hundredfold(2), int)


def test_a_call_from_python_reports_the_function():
    _norm(3.0, 4.0)
    with pytest.raises(KeyError, match="only compiled functions can call _square"):
        _square(3.0)
