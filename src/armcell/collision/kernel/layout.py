"""Memory layout of the kernel data: a `Pack` as three flat arrays.

Numba counts the references of every array that is passed or taken out of a tuple with atomic instructions;
with thirty arrays in a tuple, the kernel was eight times slower. All integers are therefore in one int32
array `I`, all floats in a float32 array `F`, and all doubles in a float64 array `D`. The first integers of
`I` hold the counts and the start index of each table.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.pack import Pack

Flat = tuple[NDArray[np.int32], NDArray[np.float32], NDArray[np.float64]]

# indices of the counts in I
DOF, FRAMES, BODIES, GROUPS, SPHERES, PAIRS, OBJECTS = range(7)
# indices in I of the start of each integer table
(
    PARENT,
    KIND,
    COLUMN,
    FRAME,
    BODY_GROUPS,
    GROUP_SPHERES,
    BODY_PIECES,
    PAIR,
    NEAR,
    NEAR_GROUPS,
    MEET,
    MEET_GROUPS,
    SHAPE_KIND,
    SHAPE_OBJECT,
    SHAPE_PLANES,
    SHAPE_PIECES,
    CHILD,
    PIECE_KIND,
    PIECE_POINTS,
    SHAPE_CLOUD,
    CLOUD,
    CLOUD_CHILD,
) = range(7, 29)
# indices in I of the start of each float table in F
(
    FIXED,
    MULTIPLIER,
    OFFSET,
    BODY_SPHERE,
    PADDING,
    MARGIN,
    GROUP_SPHERE,
    SPHERE,
    RATE,
    PAIR_RATE,
    SHAPE_POSE,
    SHAPE_SIZE,
    PLANES,
    BOXES,
    POINTS32,
    CLOUD_BOXES,
    CLOUD_PARTS,
    PAIR_MARGIN,
) = range(29, 47)
# indices in I of the start of each double table in D
(
    PIECE_SIZE,
    PIECE_POSE,
    PIECE_BALL,
    POINTS,
    REACH,
    PAIR_REACH,
) = range(47, 53)
HEADER = 53

_INTS = (
    "parent",
    "kind",
    "column",
    "frame",
    "body_groups",
    "group_spheres",
    "body_pieces",
    "pairs",
    "near",
    "near_groups",
    "meet",
    "meet_groups",
    "shape_kind",
    "shape_object",
    "shape_planes",
    "shape_pieces",
    "child",
    "piece_kind",
    "piece_points",
    "shape_cloud",
    "cloud",
    "cloud_child",
)
_FLOATS = (
    "fixed",
    "multiplier",
    "offset",
    "body_sphere",
    "padding",
    "margin",
    "group_sphere",
    "sphere",
    "rate",
    "pair_rate",
    "shape_pose",
    "shape_size",
    "planes",
    "boxes",
    "points32",
    "cloud_boxes",
    "cloud_parts",
    "pair_margin",
)
_DOUBLES = (
    "piece_size",
    "piece_pose",
    "piece_ball",
    "points",
    "reach",
    "pair_reach",
)


def flatten(p: Pack) -> Flat:
    """Return the arrays of a `Pack` in the memory layout of the kernel: the three flat arrays I, F and D."""
    counts = [
        p.dof, len(p.parent), len(p.frame), len(p.group_sphere), len(p.sphere), len(p.pairs),
        p.margin.shape[1],
    ]  # fmt: skip
    header = np.zeros(HEADER, np.int32)
    header[: len(counts)] = counts

    def table(names: tuple[str, ...], first: int, dtype: type, begin: int) -> list[np.ndarray]:
        parts, at = [], begin
        for i, name in enumerate(names):
            flat = np.ascontiguousarray(getattr(p, name)).astype(dtype, copy=False).ravel()
            header[first + i] = at
            at += len(flat)
            parts.append(flat)
        return parts

    ints = table(_INTS, PARENT, np.int32, HEADER)
    floats = table(_FLOATS, FIXED, np.float32, 0)
    doubles = table(_DOUBLES, PIECE_SIZE, np.float64, 0)
    return np.concatenate([header, *ints]), np.concatenate(floats), np.concatenate(doubles)
