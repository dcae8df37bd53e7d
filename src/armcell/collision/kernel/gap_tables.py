"""Tables of the gap between two robot bodies that at most two joints move relative to each other.

On a UR arm, the wrist passes the forearm at 14 mm in nearly all states: too near for two sphere covers, so
the kernel left a tenth of all blocks to exact tests, for a gap that only two joints change. For such pairs, a
table contains a lower bound of the exact gap in each cell of the joints' ranges. Where the bound exceeds the
motion to be checked, the kernel needs no spheres and no exact test.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I32 = NDArray[np.int32]

CELL = 4e-3  # [m] approximate motion from a measured state to the border of its box, per joint
CELLS = 64  # stored cells per joint at most; each has the smallest bound of several boxes
FAR = 0.03  # [m] larger gaps are not resolved any further: spheres decide about them
ROUNDING = 1e-4  # [m] subtracted from every gap
SAMPLES = 200
SHARE = 0.05  # smallest share of sampled states with an undecided gap that justifies a table
MOST = 15_000  # pairs that need more measured states have no table: measuring would take seconds
MOST_TRIANGLES = 4000  # of both bodies; between larger meshes, one distance takes milliseconds
NEVER = 1e9  # period of joint values that do not repeat
VERSION = 3  # increase when the tables change, to invalidate the disk cache


class JointRanges(NamedTuple):
    """Ranges of the one or two joints that move a pair of bodies, for a gap table. With one joint, the second
    range is a single point.

    Attributes:
        lower, upper: (2,) [rad or m].
        turns: (2,) whether values repeat after 2 pi; the range is then one turn.
        reach: (2,) [m per rad or m] upper bound of the bodies' relative motion per unit of each joint.
    """

    lower: F64
    upper: F64
    turns: NDArray[np.bool_]
    reach: F64


def gap_table(distance: Callable[[F64], float], ranges: JointRanges, undecided: float) -> F32:
    """Return lower bounds [m] of the gap between two bodies, one per cell of the joints' ranges (n1, n2). The
    array is empty if sphere covers nearly always decide about the pair.

    A bound is the gap in the middle of a box of joint values minus the motion to the box's border.

    Args:
        distance: returns the exact signed distance [m] of the bodies at the joint values (2,).
        ranges: the joints' ranges and reach.
        undecided: [m] sphere covers do not decide about smaller gaps.
    """
    span, none = ranges.upper - ranges.lower, np.zeros((0, 0), np.float32)
    needed = np.maximum(np.ceil(span * ranges.reach / (2 * CELL)), 1).astype(int)
    cells = np.minimum(needed, CELLS)
    per_cell = needed // cells
    counts = cells * per_cell
    samples = np.random.default_rng(0).uniform(ranges.lower, ranges.upper, (SAMPLES, 2))
    gaps = np.array([distance(q) for q in samples])
    if np.mean((gaps > 0) & (gaps < undecided)) < SHARE or counts.prod() > MOST:
        return none
    table = np.zeros(counts)
    boxes = [(np.array(k) * per_cell, (np.array(k) + 1) * per_cell) for k in np.ndindex(*cells)]
    while boxes:
        first, end = boxes.pop()
        motion = 0.5 * (end - first) * span / counts * ranges.reach
        bound = distance(ranges.lower + 0.5 * (first + end) * span / counts) - motion.sum()
        if bound >= FAR or (end - first).max() == 1:
            table[first[0] : end[0], first[1] : end[1]] = bound - ROUNDING
            continue
        middle = np.where(end - first > 1, (first + end) // 2, end)
        for x in ((first[0], middle[0]), (middle[0], end[0])):
            for y in ((first[1], middle[1]), (middle[1], end[1])):
                if x[0] < x[1] and y[0] < y[1]:
                    boxes.append((np.array([x[0], y[0]]), np.array([x[1], y[1]])))
    smallest = table.reshape(cells[0], per_cell[0], cells[1], per_cell[1]).min(axis=(1, 3))
    return smallest.astype(np.float32)


def grid(ranges: JointRanges, counts: tuple[int, int]) -> F32:
    """Return the numbers (6,) with which the kernel finds a cell of a gap table. For each of two joints, they
    are the lower limit [rad or m], the cells per unit [rad or m], and the cells per turn.
    """
    span = ranges.upper - ranges.lower
    per_unit = np.divide(counts, span, out=np.zeros(2), where=span > 0)
    period = np.where(ranges.turns, counts, NEVER)
    return np.stack([ranges.lower, per_unit, period], axis=1).ravel().astype(np.float32)
