"""Point clouds and octomaps from files (.ply, .pcd, .xyz, .npy, .bt, .ot, .npz), and depth image points.

The data of a .pcd file are ascii, binary or binary_compressed. An .npz file with `centers` (n, 3) and
`sizes` (n,) contains the cells of a `core.Octree`.
"""

from __future__ import annotations

import io
import logging
import re
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from armcell.core import SE3, InputError, Octree, PointCloud, UnknownNameError, finite_points
from armcell.core.checks import float_array
from armcell.scene.octree_file import load_octree, read_bytes

log = logging.getLogger(__name__)

F64 = NDArray[np.float64]

MAX_BYTES = 1_000_000_000
MAX_POINTS = 50_000_000
OCTREES = (".bt", ".ot", ".npz")
_KINDS = {"F": "f", "I": "i", "U": "u"}


def load_obstacle(path: str | Path, radius: float | None = None) -> PointCloud | Octree:
    """Load an obstacle from a point cloud file, whose points get a radius [m], or from an octomap file.

    The suffix determines the format. Octomaps have cells and need no radius.
    """
    file = Path(path)
    if file.suffix.lower() == ".npz":
        return _cells(file)
    if file.suffix.lower() in OCTREES:
        return load_octree(file)
    if radius is None:
        raise InputError(
            "a point cloud needs a radius", file=file, hint="half the points' spacing or a bit more"
        )
    return PointCloud(load_points(file), radius)


def load_points(path: str | Path) -> F64:
    """Load the points (n, 3) [m] from a point cloud file.
    Points with infinite or NaN coordinates are dropped.

    Other points, which mark pixels without depth, are dropped and logged.

    Raises:
        InputError: unknown suffix, broken file (with line or byte where there is one), or no finite point.
    """
    file = Path(path)
    suffix = file.suffix.lower()
    if suffix not in READERS:
        known = [*READERS, *OCTREES]
        raise UnknownNameError("point cloud format", suffix or file.name, known, file=file)
    data = read_bytes(file, MAX_BYTES)
    every = READERS[suffix](data, file)
    points, left_out = finite_points(every)
    if len(points) == 0:
        raise InputError(
            f"none of its {left_out} points is finite" if left_out else "has no points", file=file
        )
    if left_out:
        log.warning("%s: %d of %d points are not finite and left out", file, left_out, len(every))
    return points


def _text(data: bytes, file: Path) -> str:
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"is not text (byte {error.start})", file=file) from None


def _table(lines: list[str], columns: list[int], first: int, file: Path) -> F64:
    """Parse selected columns of a point cloud in a text file. Commas or white space separate the numbers.

    `first` is the line number of the first line, for error messages.
    """
    rows = [line.partition("#")[0].replace(",", " ") for line in lines]
    if not any(row.strip() for row in rows):
        return np.zeros((0, len(columns)))
    try:
        return np.loadtxt(rows, usecols=columns, ndmin=2)
    except (ValueError, IndexError):
        for i, row in enumerate(rows):
            words = row.split()
            try:
                _ = words and [float(words[c]) for c in columns]
            except IndexError:
                reason = f"has {len(words)} numbers, {max(columns) + 1} are needed"
                raise InputError(reason, file=file, line=first + i) from None
            except ValueError as error:
                raise InputError(str(error), file=file, line=first + i) from None
        raise InputError("has lines of different lengths", file=file) from None


def _xyz(data: bytes, file: Path) -> F64:
    return _table(_text(data, file).splitlines(), [0, 1, 2], 1, file)


def _npy(data: bytes, file: Path) -> F64:
    try:
        array = np.load(io.BytesIO(data), allow_pickle=False)
    except Exception as error:  # NumPy raises different errors for invalid headers
        raise InputError(f"cannot be read as a NumPy array: {error}", file=file) from None
    if not isinstance(array, np.ndarray) or array.ndim < 2 or array.shape[-1] < 3:
        raise InputError(f"holds an array of shape {np.shape(array)}, points need (n, 3)", file=file)
    if array.dtype.kind not in "fiu":
        raise InputError(f"holds {array.dtype}, points need numbers", file=file)
    return array[..., :3].reshape(-1, 3).astype(float)


def _cells(file: Path) -> Octree:
    data = read_bytes(file, MAX_BYTES)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            unpacked = sum(entry.file_size for entry in archive.infolist())
        if unpacked > MAX_BYTES:
            raise InputError(f"unpacks to more than {MAX_BYTES} bytes", file=file)
        with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
            return Octree(arrays["centers"], arrays["sizes"])
    except InputError as error:
        raise error if error.file else InputError(error.reason, file=file) from None
    except Exception as error:  # NumPy raises different errors for invalid headers
        reason = f"cannot be read as cells (arrays 'centers' and 'sizes'): {error}"
        raise InputError(reason, file=file) from None


def _ply(data: bytes, file: Path) -> F64:
    import trimesh

    if not data.startswith(b"ply"):
        raise InputError("is no PLY file: it does not begin with 'ply'", file=file)
    announced = re.search(rb"element\s+vertex\s+(\d+)", data[:20_000])
    if announced is None:
        raise InputError("PLY header has no 'element vertex'", file=file)
    count = int(announced[1])
    if count == 0:
        return np.zeros((0, 3))
    if count > MAX_POINTS:
        raise InputError(f"PLY header announces {count} points, at most {MAX_POINTS} are read", file=file)
    try:
        loaded = trimesh.load(io.BytesIO(data), file_type="ply", process=False)
        points = np.asarray(loaded.vertices, dtype=float)  # pyright: ignore[reportAttributeAccessIssue]
    except Exception as error:  # trimesh raises different errors for invalid files
        raise InputError(f"cannot be read as PLY: {error}", file=file) from None
    if len(points) != count:
        raise InputError(f"PLY header announces {count} points, the file has {len(points)}", file=file)
    return points


def _pcd(data: bytes, file: Path) -> F64:
    """Parse the points from a PCD file, the Point Cloud Library's
    format for point clouds, up to version 0.7.
    """
    header: dict[str, list[str]] = {}
    at, line = 0, 0
    while "DATA" not in header:
        end = data.find(b"\n", at)
        line += 1
        if end < 0 or end - at > 10_000:
            raise InputError("PCD header has no DATA line", file=file, line=line)
        words = data[at:end].decode("ascii", "replace").partition("#")[0].split()
        at = end + 1
        if words:
            header[words[0].upper()] = words[1:]
    try:
        names = [name.lower() for name in header["FIELDS"]]
        counts = [int(c) for c in header.get("COUNT", ["1"] * len(names))]
        sizes = [int(s) for s in header["SIZE"]]
        types = [_KINDS[t] + str(s) for t, s in zip(header["TYPE"], sizes, strict=True)]
        points = int(header["POINTS"][0]) if "POINTS" in header else (
            int(header["WIDTH"][0]) * int(header["HEIGHT"][0])
        )  # fmt: skip
        layout = [(n, "<" + t, c) for n, t, c in zip(names, types, counts, strict=True)]
        columns = [names.index(axis) for axis in "xyz"]
        encoding = header["DATA"][0]
        record = np.dtype([(str(i), t, (c,)) for i, (_, t, c) in enumerate(layout)])
    except (KeyError, ValueError, IndexError, TypeError) as error:
        raise InputError(f"PCD header is broken or has no x, y, z: {error}", file=file) from None
    if not 0 <= points <= MAX_POINTS or any(c < 1 for c in counts) or record.itemsize > 10_000:
        raise InputError(f"PCD header announces {points} points of {record.itemsize} bytes", file=file)
    body = data[at:]
    if encoding == "ascii":
        starts = np.cumsum([0, *counts])
        rows = _table(_text(body, file).splitlines(), [int(starts[c]) for c in columns], line + 1, file)
    elif encoding in ("binary", "binary_compressed"):
        if encoding == "binary_compressed":
            body = _unpacked(body, points * record.itemsize, file)
        needed = points * record.itemsize
        if len(body) < needed:
            raise InputError(f"PCD is cut off: {len(body)} of {needed} bytes of data", file=file)
        if encoding == "binary":
            table = np.frombuffer(body, record, points)
            rows = np.column_stack([table[str(c)][:, 0] for c in columns]).astype(float)
        else:  # one field after the other
            starts = np.cumsum([0, *(points * np.dtype(t).itemsize * c for _, t, c in layout)])
            rows = np.column_stack([
                np.frombuffer(body, layout[c][1], points * counts[c], int(starts[c]))[:: counts[c]]
                for c in columns
            ]).astype(float)  # fmt: skip
    else:
        known = ["ascii", "binary", "binary_compressed"]
        raise UnknownNameError("PCD encoding", encoding, known, file=file, line=line)
    if len(rows) != points:
        raise InputError(f"PCD header announces {points} points, the file has {len(rows)}", file=file)
    return rows


def _unpacked(body: bytes, size: int, file: Path) -> bytes:
    """Decompress the data of a compressed PCD file, which consists of two sizes (uint32) and LZF data."""
    if len(body) < 8:
        raise InputError("PCD is cut off before its compressed data", file=file)
    packed, unpacked = (int(n) for n in np.frombuffer(body, "<u4", 2))
    if unpacked != size:
        raise InputError(f"PCD holds {unpacked} bytes of data, its header needs {size}", file=file)
    if len(body) - 8 < packed:
        raise InputError(f"PCD is cut off: {len(body) - 8} of {packed} compressed bytes", file=file)
    out = np.empty(unpacked, np.uint8)
    if _unlzf(np.frombuffer(body, np.uint8, packed, 8), out) != unpacked:
        raise InputError("PCD has compressed data that cannot be unpacked", file=file)
    return out.tobytes()


@njit(cache=True)
def _unlzf(data, out):
    """Decompress the LZF data of a point cloud file (Marc Lehmann's liblzf). Return the number of bytes
    written.

    The result is -1 if the data are invalid. A control byte n below 32 precedes n + 1 literal bytes. The
    upper three bits of any other control byte are the length of a copy (if 7, the next byte is added); the
    lower five bits and the next byte are the distance back to the copied bytes.
    """
    i, n = 0, 0
    while i < len(data):
        control = np.int64(data[i])
        i += 1
        if control < 32:
            length = control + 1
            if i + length > len(data) or n + length > len(out):
                return -1
            out[n : n + length] = data[i : i + length]
            i, n = i + length, n + length
            continue
        length = control >> 5
        if length == 7:
            if i >= len(data):
                return -1
            length += np.int64(data[i])
            i += 1
        if i >= len(data):
            return -1
        back = n - ((control & 31) << 8) - np.int64(data[i]) - 1
        i, length = i + 1, length + 2
        if back < 0 or n + length > len(out):
            return -1
        for k in range(length):  # may overlap: byte by byte
            out[n + k] = out[back + k]
        n += length
    return n


READERS: dict[str, Callable[[bytes, Path], F64]] = {".npy": _npy, ".pcd": _pcd, ".ply": _ply, ".xyz": _xyz}


def depth_points(
    depth: ArrayLike,
    intrinsics: ArrayLike,
    T_world_camera: SE3 = SE3.identity(),
    nearest: float = 0.0,
    farthest: float = np.inf,
) -> F64:
    """Convert the depth image of a camera to a point cloud (n, 3) [m, world frame].

    Args:
        depth: (rows, columns) distances along the optical axis, either floats [m] or integers [mm] (ROS's
            16UC1 encoding). Pixels that are NaN, infinite or not positive are left out.
        intrinsics: camera matrix K (3, 3) [px]; integer coordinates are pixel centers.
        T_world_camera: pose of the optical frame (z forward, x right, y down).
        nearest, farthest: points outside this range of depths [m] are left out.
    Raises:
        InputError: `depth` is not a 2D array of numbers, or `intrinsics` is not a valid camera matrix.
    """
    z, K = _meters(depth), _camera_matrix(intrinsics)
    seen = (z > 0) & (z >= nearest) & (z <= farthest)
    v, u = np.nonzero(seen)
    z = z[seen]
    x, y = (u - K[0, 2]) * z / K[0, 0], (v - K[1, 2]) * z / K[1, 1]
    return T_world_camera.apply(np.column_stack([x, y, z]))


def seen_through(
    points: ArrayLike,
    depth: ArrayLike,
    intrinsics: ArrayLike,
    T_world_camera: SE3 = SE3.identity(),
    margin: float = 0.02,
) -> NDArray[np.bool_]:
    """Return a mask (n,) of the points where a depth image proves free space: the camera saw surfaces behind
    them. An obstacle that contains such points has moved, so `PointCloud.updated` can clear them.

    The four pixels around a point must all be deeper than the point. A pixel without depth proves nothing.

    Args:
        points: (n, 3) [m, world frame].
        depth, intrinsics, T_world_camera: as of `depth_points`.
        margin: depth [m] by which the surfaces must be behind the point; covers the errors of the camera and
            the radius of the points.
    Raises:
        InputError: as of `depth_points`, or the points do not have the shape (n, 3).
    """
    z, K = _meters(depth), _camera_matrix(intrinsics)
    rows = float_array(points, (-1, 3), "points", finite=False).reshape(-1, 3)
    at = np.ascontiguousarray(T_world_camera.inverse().apply(rows).T)
    front = np.flatnonzero(at[2] > 0)
    at = at[:, front]
    u, v = at[0] / at[2] * K[0, 0] + K[0, 2], at[1] / at[2] * K[1, 1] + K[1, 2]
    inside = (u >= 0) & (u <= z.shape[1] - 1) & (v >= 0) & (v <= z.shape[0] - 1)
    u, v, front, far = u[inside], v[inside], front[inside], at[2, inside] + margin
    across, down = ([np.floor(a).astype(int), np.ceil(a).astype(int)] for a in (u, v))
    free = np.zeros(len(rows), bool)
    free[front] = np.logical_and.reduce([z[i, j] > far for i in down for j in across])
    return free


def _meters(depth: ArrayLike) -> F64:
    """Return the depths [m] of a depth image (rows, columns). Pixels without depth are 0."""
    float_array(depth, None, "a depth image", finite=False)
    image = np.asarray(depth)
    if image.ndim != 2 or image.dtype.kind not in "fiu":
        raise InputError(f"a depth image has rows and columns of numbers, not shape {image.shape}")
    z = image.astype(float) * (1.0 if image.dtype.kind == "f" else 1e-3)
    return np.where(np.isfinite(z), z, 0.0)


def _camera_matrix(intrinsics: ArrayLike) -> F64:
    K = float_array(intrinsics, (3, 3), "intrinsics")
    if K[0, 0] <= 0 or K[1, 1] <= 0:
        raise InputError("intrinsics need a (3, 3) matrix with positive focal lengths")
    return K
