"""Contacts of each pair of bodies in very many sampled configurations, 16 at a time.

`_check_arrays` stops checking a lane at its first contact. This module checks every pair separately: it
changes a few numbers at the head of the pack, so that the check sees only that pair.
"""

# pyright: reportCallIssue=false
# Numba calls intrinsics without their typing context, and splices tuples into compiled calls.
from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba import njit
from numpy.typing import NDArray

from armcell.collision.kernel.block import EVERY, EXACT, PROVE, check_block, handle_of, ints, lanes_of
from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.kernel.frames import workspace
from armcell.collision.kernel.layout import NEAR, PAIR, PAIRS
from armcell.collision.kernel.simd import L, pointer

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Masks = NDArray[np.uint16]

CHUNK = 4096  # samples between two calls of `progress`


@njit(cache=True, nogil=True)
def _ask_pairs(handle, pairs, q, masks):
    """Fill a mask (pairs, blocks) for body pairs.
    The bits of each entry mark the sampled configurations in which the pair is close.

    A block has 16 rows of q.
    """
    k = pointer(handle)
    I, w = ints(k), lanes_of(k)
    first_pair, first_near, dof = I[PAIR], I[NEAR], q.shape[1]
    I[PAIRS] = np.int32(1)
    for block in range(masks.shape[1]):
        for lane in range(L):
            row = min(block * L + lane, len(q) - 1)
            for j in range(dof):
                w[j * L + lane] = np.float32(q[row, j])
        for p in range(len(pairs)):
            I[PAIR] = np.int32(first_pair + 2 * pairs[p])
            I[NEAR] = np.int32(first_near + pairs[p])
            # A proof over an interval of zero width checks the configuration itself, and continues to the
            # end for every lane.
            masks[p, block] = np.uint16(check_block(k, EVERY, np.int64(EXACT | PROVE)))
    I[PAIR], I[NEAR] = np.int32(first_pair), np.int32(first_near)


class PairSampler:
    """Sampler that finds the contacts of each pair of bodies in a very large number of configurations.

    Pairs that `near` proved apart are left out.

    Attributes:
        pairs: (k, 2) names of the bodies that may meet.
    """

    def __init__(self, checker: KernelChecker):
        I, F, D = checker.flat
        self._flat = (I.copy(), F, D)  # other checkers read the original
        self._work = workspace(self._flat)
        self._slack = np.zeros(max(len(checker.pack.frame), 1), np.float32)
        self._slack_pair = np.zeros(max(len(checker.pack.pairs), 1), np.float32)
        self._handle = handle_of((*self._flat, *self._work, self._slack, self._slack_pair))
        self._count = len(checker.pack.pairs)
        names = checker.names.bodies
        self.pairs = [(names[i], names[j]) for i, j in checker.pack.pairs]

    def contact_masks(
        self, numbers: I64, q: F64, within: float = 0.0, progress: Callable[[int], None] | None = None
    ) -> NDArray[np.bool_]:
        """Return a mask (len(numbers), samples) of the sampled configurations in which a body pair is in
        contact.

        Args:
            numbers: indices in `pairs`.
            q: configurations (samples, dof) of all joints.
            within: [m] largest distance that counts as contact.
            progress: receives the number of finished samples.
        """
        self._slack[:] = self._slack_pair[:] = within  # the bodies' slack decides which pairs are skipped
        numbers = np.ascontiguousarray(numbers, dtype=np.int64)
        found = np.zeros((len(numbers), len(q)), bool)
        for start in range(0, len(q), CHUNK):
            part = np.ascontiguousarray(q[start : start + CHUNK], dtype=float)
            masks = np.zeros((len(numbers), -(-len(part) // L)), np.uint16)
            if len(numbers):
                _ask_pairs(self._handle, numbers, part, masks)
            bits = np.unpackbits(masks.view(np.uint8), axis=1, bitorder="little")
            found[:, start : start + len(part)] = bits[:, : len(part)]
            if progress:
                progress(min(start + CHUNK, len(q)))
        return found
