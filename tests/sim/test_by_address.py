"""Arrays that compiled functions take by address."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit

from armcell.sim.array_pointers import addresses_of, matrix, vector


@njit
def _doubled(table):
    """Add the matrix's rows to the vector; double the matrix in place."""
    v, m = vector(table, 0, np.int32), matrix(table, 1, np.float64)
    for i in range(m.shape[0]):
        for j in range(m.shape[1]):
            v[i] += m[i, j]
            m[i, j] *= 2
    return v.shape[0], m.shape


@pytest.mark.slow
def test_compiled_code_reads_and_writes_in_place():
    v, m = np.array([1, 2], np.int32), np.arange(6.0).reshape(2, 3)
    assert _doubled(addresses_of([v, m], [np.int32, np.float64])) == (2, (2, 3))
    assert v.tolist() == [4, 14] and m.tolist() == [[0.0, 2.0, 4.0], [6.0, 8.0, 10.0]]


@pytest.mark.parametrize("wrong", [np.zeros(3, np.float32), np.zeros((4, 4)).T[:2], np.zeros(6)[::2]])
def test_another_type_or_layout_is_refused(wrong):
    with pytest.raises(TypeError, match="array 0"):
        addresses_of([wrong], [np.float64])
