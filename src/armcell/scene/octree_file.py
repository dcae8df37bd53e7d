"""Reader and writer of OctoMap's octree files and messages: `.bt` (occupancy) and `.ot` (log-odds).

The reader accepts both formats, `.ot` with optional colors. The writer produces the binary format of
.bt files and octomap_msgs/Octomap.
"""

from __future__ import annotations

import stat
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

from armcell.core import InputError, Octree
from armcell.scene.octomap import HALF, voxel_codes

MAX_BYTES = 500_000_000
DEPTH = 16
FULL, BINARY = b"# Octomap OcTree file", b"# Octomap OcTree binary file"
COLOR_BYTES = {"OcTree": 0, "OcTreeStamped": 0, "ColorOcTree": 3}
MORE, TRUNCATED, TOO_DEEP = 0, 1, 2
I64 = NDArray[np.int64]
OFF = 1e-3  # [voxels] tolerance for a cell to count as on the grid
MOST = 20_000_000  # maximum number of voxels that replace cells off the grid


def load_octree(path: str | Path) -> Octree:
    """Load the occupied leaves of an OctoMap file (`.bt` or `.ot`) as an octree.

    Raises:
        InputError: the file is not an octomap, has an unknown kind, is truncated, or has extra bytes.
    """
    file = Path(path)
    data = read_bytes(file, MAX_BYTES)
    binary = data.startswith(BINARY)
    if not binary and not data.startswith(FULL):
        raise InputError(
            "is no octomap: it begins neither with "
            f"{BINARY.decode()!r} nor with {FULL.decode()!r}",
            file=file,
        )  # fmt: skip
    header, found, body = data.partition(b"\ndata\n")
    if not found:
        raise InputError("the octomap's header has no line 'data': the file is cut off", file=file)
    words: dict[str, str] = {}
    for number, line in enumerate(header.decode("ascii", "replace").splitlines(), start=1):
        if line.strip() and not line.startswith("#"):
            key, _, value = line.strip().partition(" ")
            if key not in ("id", "size", "res"):
                raise InputError(f"unknown entry {key!r} in the octomap's header", file=file, line=number)
            words[key] = value.strip()
    kind = words.get("id", "OcTree" if binary else "")
    if kind not in COLOR_BYTES:
        raise InputError(f"octomap of kind {kind!r} is not read; known: {', '.join(COLOR_BYTES)}", file=file)
    try:
        size, resolution = int(words["size"]), float(words["res"])
    except (KeyError, ValueError):
        raise InputError("the octomap's header needs 'size' and 'res' with numbers", file=file) from None
    if size == 0:
        return Octree(np.zeros((0, 3)), np.zeros(0))
    return octree_from_bytes(body, resolution, binary, kind, file)


def octree_from_bytes(
    body: bytes, resolution: float, binary: bool, kind: str = "OcTree", file: Path | None = None
) -> Octree:
    """Decode the occupied leaves of an octomap from the bytes of an octree file or message.

    The message is octomap_msgs/Octomap.

    Raises:
        InputError: the octomap has an unknown kind, is truncated, is too deep, or has extra bytes.
    """
    if kind not in COLOR_BYTES:
        raise InputError(f"octomap of kind {kind!r} is not read; known: {', '.join(COLOR_BYTES)}", file=file)
    if not (np.isfinite(resolution) and resolution > 0):
        raise InputError(f"the octomap's resolution is {resolution:g} m, it must be positive", file=file)
    bytes_ = np.frombuffer(body, np.uint8)
    read, state, keys, depths = (
        _read_binary(bytes_) if binary else _read_full(bytes_, 4 + COLOR_BYTES[kind])
    )  # fmt: skip
    if state == TRUNCATED:
        raise InputError(f"the octomap is cut off after {len(body)} bytes of data", file=file)
    if state == TOO_DEEP:
        raise InputError(f"the octomap is deeper than {DEPTH} levels at byte {read} of its data", file=file)
    if body[read:].strip():
        raise InputError(f"the octomap has {len(body) - read} bytes too many at its end", file=file)
    edges = 2.0 ** (DEPTH - depths)
    lowest = keys * edges[:, None] - 2.0 ** (DEPTH - 1)
    sizes = np.asarray(edges * resolution, dtype=np.float64)
    return Octree(lowest * resolution + sizes[:, None] / 2, sizes)


def read_bytes(path: Path, limit: int) -> bytes:
    """Return the bytes of an octree file, which must be a regular file of at most `limit` bytes."""
    try:
        info = path.stat()
        if not stat.S_ISREG(info.st_mode):
            raise InputError("is no regular file", file=path)
        if info.st_size > limit:
            raise InputError(f"is larger than {limit} bytes", file=path)
        data = path.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        raise InputError("file not found", file=path) from None
    except (OSError, ValueError) as error:  # no permission, a name that is too long or has a NUL
        raise InputError(f"cannot be read: {getattr(error, 'strerror', error)}", file=path) from None
    if not data:
        raise InputError("is empty", file=path)
    return data


@njit(cache=True)
def _read_binary(data):
    """Decode the octomap of a .bt file, which has OctoMap's binary format, and return its occupied leaves.

    A node has two bytes with two bits per child: 01 is occupied, 10 is free, and 11 is a child with children
    of its own, whose node follows.

    Returns:
        Number of bytes read; status (`MORE`, `TRUNCATED` or `TOO_DEEP`); keys (n, 3) and depths (n,) of the
        leaves.
    """
    most = len(data) * 4 + 8
    keys, depths, n = np.empty((most, 3), np.int64), np.empty(most, np.int64), 0
    stack = np.zeros((8 * DEPTH + 8, 4), np.int64)  # x, y, z, depth
    top, at = 1, 0
    while top > 0:
        top -= 1
        x, y, z, depth = stack[top]
        if depth >= DEPTH:
            return at, TOO_DEEP, keys[:n], depths[:n]
        if at + 2 > len(data):
            return at, TRUNCATED, keys[:n], depths[:n]
        bits = np.int64(data[at]) | (np.int64(data[at + 1]) << 8)
        at += 2
        for child in range(7, -1, -1):  # last child first, because the stack reverses the order
            state = (bits >> (2 * child)) & 3
            cx, cy, cz = 2 * x + (child & 1), 2 * y + ((child >> 1) & 1), 2 * z + (child >> 2)
            if state == 2:  # 01 in OctoMap's order: the number has the bits reversed
                keys[n, 0], keys[n, 1], keys[n, 2], depths[n] = cx, cy, cz, depth + 1
                n += 1
            elif state == 3:
                stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3] = cx, cy, cz, depth + 1
                top += 1
    return at, MORE, keys[:n], depths[:n]


@njit(cache=True)
def _read_full(data, width):
    """Decode the octomap of an .ot file, which has OctoMap's full format, and return its occupied leaves.

    A node has `width` bytes with its log-odds (and color), and one byte with a bit per child. The results
    are those of `_read_binary`.
    """
    most = len(data) // (width + 1) + 1
    keys, depths, n = np.empty((most, 3), np.int64), np.empty(most, np.int64), 0
    stack = np.zeros((8 * DEPTH + 16, 4), np.int64)
    top, at = 1, 0
    while top > 0:
        top -= 1
        x, y, z, depth = stack[top]
        if depth > DEPTH:
            return at, TOO_DEEP, keys[:n], depths[:n]
        if at + width + 1 > len(data):
            return at, TRUNCATED, keys[:n], depths[:n]
        # Log-odds of at least 0 are occupied: the sign bit of a little-endian float32; -0.0 is 0 as well.
        negative = data[at + 3] >= 128 and (
            data[at] | data[at + 1] | data[at + 2] | (data[at + 3] & 127)
        ) != 0  # fmt: skip
        children = data[at + width]
        at += width + 1
        if children == 0 and not negative:
            keys[n, 0], keys[n, 1], keys[n, 2], depths[n] = x, y, z, depth
            n += 1
        for child in range(7, -1, -1):
            if (children >> child) & 1:
                stack[top, 0] = 2 * x + (child & 1)
                stack[top, 1] = 2 * y + ((child >> 1) & 1)
                stack[top, 2] = 2 * z + (child >> 2)
                stack[top, 3] = depth + 1
                top += 1
    return at, MORE, keys[:n], depths[:n]


LEAF, INNER = 2, 3  # the two bits that encode a child node, as a little-endian number


def octree_bytes(octree: Octree) -> tuple[bytes, float]:
    """Encode an octree as the content of an octree file, in OctoMap's binary format.

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
    """Return the octomap voxels (m, 3) that the given cells of an octree overlap, to write the octree to a
    file.

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
    """Remove the octree cells that are inside another cell, and return the remaining cells, to write the
    octree to a file.
    """
    order = np.lexsort((-numbers, starts))
    starts, numbers = starts[order], numbers[order]
    ends = np.maximum.accumulate(starts + numbers)
    own = np.ones(len(starts), bool)
    own[1:] = starts[1:] >= ends[:-1]
    return starts[own], numbers[own]
