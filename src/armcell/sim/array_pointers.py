"""Passing of arrays by address to compiled functions that run hundreds of times a second.

Numba takes 0.15 us for each array argument. Passing 26 arrays that never change took as long as half a
physics step.
"""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context.
from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit, types
from numba.extending import intrinsic
from numba.np.numpy_support import carray
from numpy.typing import DTypeLike, NDArray


def addresses_of(arrays: Sequence[NDArray], dtypes: Sequence[DTypeLike]) -> NDArray[np.int64]:
    """Return a table (n, 3) with the memory addresses and shapes of arrays, for use in compiled functions.

    The second size of a vector is 1. The caller must keep the arrays alive.

    Args:
        arrays: the arrays, vectors or matrices.
        dtypes: type of each array in the compiled function.
    Raises:
        TypeError: an array has another type, or is not contiguous.
    """
    table = np.ones((len(arrays), 3), np.int64)
    for k, (row, array, dtype) in enumerate(zip(table, arrays, dtypes, strict=True)):
        if array.dtype != dtype or not array.flags.c_contiguous:
            raise TypeError(f"array {k} is {array.dtype}, it must be {dtype} and contiguous")
        row[0] = array.ctypes.data
        row[1 : 1 + array.ndim] = array.shape
    return table


@intrinsic
def _pointer(typingctx, dtype, address):
    kind = types.CPointer(dtype.dtype)

    def codegen(context, builder, signature, args):
        return builder.inttoptr(args[1], context.get_value_type(kind))

    return kind(dtype, address), codegen


@njit(cache=True, forceinline=True)
def vector(table, k, dtype):
    """Return the array (n,) whose memory address is in row k of a table, for use in compiled functions."""
    return carray(_pointer(dtype, table[k, 0]), table[k, 1])


@njit(cache=True, forceinline=True)
def matrix(table, k, dtype):
    """Return the array (n, m) whose memory address is in row k of a table, for use in compiled functions."""
    return carray(_pointer(dtype, table[k, 0]), (table[k, 1], table[k, 2]))
