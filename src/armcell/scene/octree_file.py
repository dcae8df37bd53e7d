"""Reader of OctoMap's files: `.bt` (binary occupancy) and `.ot` (log-odds, optional colors)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numba import njit

from armcell.core import InputError, Octree

MAX_BYTES = 500_000_000
DEPTH = 16
FULL, BINARY = b"# Octomap OcTree file", b"# Octomap OcTree binary file"
COLOR_BYTES = {"OcTree": 0, "OcTreeStamped": 0, "ColorOcTree": 3}
MORE, TRUNCATED, TOO_DEEP = 0, 1, 2


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
        if not path.is_file():
            raise InputError("file not found" if not path.exists() else "is no regular file", file=path)
        if path.stat().st_size > limit:
            raise InputError(f"is larger than {limit} bytes", file=path)
        data = path.read_bytes()
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
