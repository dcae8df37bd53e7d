"""Writer for OctoMap's binary octree format, used by .bt files and octomap_msgs/Octomap."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from armcell.core import InputError, Octree
from armcell.scene.octomap import HALF, voxel_codes
from armcell.scene.octree_file import BINARY, DEPTH

I64 = NDArray[np.int64]

OFF = 1e-3  # [voxels] tolerance for a cell to count as on the grid
MOST = 20_000_000  # maximum number of voxels that replace cells off the grid
LEAF, INNER = 2, 3  # the two bits that encode a child node, as a little-endian number


def octree_bytes(octree: Octree) -> tuple[bytes, float]:
    """Encode an octree in OctoMap's binary format.

    Cells off the octree's grid are replaced by the voxels that they overlap.

    Returns:
        The binary data (empty if the octree has no cells) and the resolution [m], the size of the smallest
            cell.
    Raises:
        InputError: the octree extends farther than OctoMap's 2^15 voxels from the origin, or cells off the
            grid overlap too many voxels.
    """
    if not len(octree.sizes):
        return b"", 0.05
    resolution = float(octree.sizes.min())
    starts, sizes = _apart(*_cells(octree, resolution))
    level = np.round(np.log2(sizes) / 3).astype(np.int64)  # 0: a single voxel
    # The format has each inner node before its descendants: sort by first voxel, larger nodes first.
    parents, depths, bits = [], [], []
    inner = np.zeros(0, np.int64)  # first voxels of the inner nodes one level below
    for up in range(1, DEPTH + 1):
        children = np.concatenate([starts[level == up - 1], inner])
        kind = np.repeat([LEAF, INNER], [len(children) - len(inner), len(inner)])
        which = (children >> (3 * (up - 1))) & 7
        inner, back = np.unique((children >> (3 * up)) << (3 * up), return_inverse=True)
        both = np.zeros(len(inner), np.int64)
        np.bitwise_or.at(both, back, kind << (2 * which))
        parents.append(inner)
        depths.append(np.full(len(inner), DEPTH - up))
        bits.append(both)
    order = np.lexsort((np.concatenate(depths), np.concatenate(parents)))
    return np.concatenate(bits)[order].astype("<u2").tobytes(), resolution


def save_octree(octree: Octree, path: str | Path) -> None:
    """Write an octree to a .bt file, which OctoMap's programs can read.

    Raises:
        InputError: the octree cannot be encoded (see `octree_bytes`), or the file cannot be written.
    """
    data, resolution = octree_bytes(octree)
    bits = np.frombuffer(data, "<u2")
    nodes = 1 + sum(int(np.count_nonzero((bits >> (2 * k)) & 3)) for k in range(8)) if data else 0
    header = f"\nid OcTree\nsize {nodes}\nres {resolution:.9g}\ndata\n".encode()
    try:
        Path(path).write_bytes(BINARY + header + data)
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}", file=Path(path)) from None


def _cells(octree: Octree, resolution: float) -> tuple[I64, I64]:
    """Convert the cells of an octree to OctoMap's voxels, for the octree writer.

    Returns:
        For each cell, the Z-order code (n,) of its first voxel and the number (n,) of its voxels.
    """
    edges = octree.sizes / resolution
    whole = 2.0 ** np.round(np.log2(edges))
    low = octree.centers / resolution - edges[:, None] / 2
    keys = np.round(low)
    on = (np.abs(edges - whole) < OFF) & np.all(np.abs(low - keys) < OFF, axis=1)
    on &= np.all(np.mod(keys, whole[:, None]) == 0, axis=1)
    voxels = _reached(low[~on], edges[~on])
    first = np.vstack([keys[on].astype(np.int64), voxels])
    number = np.concatenate([whole[on] ** 3, np.ones(len(voxels))]).astype(np.int64)
    edge = np.round(np.cbrt(number)).astype(np.int64)[:, None]
    if np.any(first < -HALF) or np.any(first + edge > HALF):
        raise InputError(
            f"the octree reaches farther than {HALF * resolution:g} m from its origin",
            hint=f"OctoMap has 2^15 voxels of {resolution:g} m to each side: use a coarser one",
        )
    return voxel_codes(first), number


def _reached(low: NDArray[np.float64], edges: NDArray[np.float64]) -> I64:
    """Return the voxels (m, 3) that the given octree cells overlap.

    The octree writer replaces each cell that does not fit OctoMap's voxel grid by these voxels.

    Args:
        low: lowest corners of the cells (n, 3) [voxels].
        edges: edge lengths (n,) [voxels].
    Raises:
        InputError: the cells overlap more than 20 million voxels.
    """
    first = np.floor(low + OFF).astype(np.int64)
    count = np.ceil(low + edges[:, None] - OFF).astype(np.int64) - first
    if np.prod(count, axis=1).sum() > MOST:
        raise InputError(
            f"cells off OctoMap's grid are more than {MOST} of its voxels", hint="use a coarser octree"
        )
    steps = [np.stack(np.meshgrid(*map(np.arange, n), indexing="ij"), -1).reshape(-1, 3) for n in count]
    return np.vstack([np.zeros((0, 3), np.int64), *(f + s for f, s in zip(first, steps, strict=True))])


def _apart(starts: I64, numbers: I64) -> tuple[I64, I64]:
    """Return the octree cells that are not inside another cell; the octree writer drops all other cells."""
    order = np.lexsort((-numbers, starts))
    starts, numbers = starts[order], numbers[order]
    ends = np.maximum.accumulate(starts + numbers)
    own = np.ones(len(starts), bool)
    own[1:] = starts[1:] >= ends[:-1]
    return starts[own], numbers[own]
