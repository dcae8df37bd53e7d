"""An occupancy map from sensor data, which stores the log-odds of voxels like OctoMap.

Voxels with a point count as hits, and voxels that a sensor's rays cross count as free. Voxels are sorted
along a Z-order curve, so the eight voxels of a larger cube are adjacent.

Source: Hornung, Wurm, Bennewitz, Stachniss and Burgard, "OctoMap: an efficient probabilistic 3D mapping
framework based on octrees", Autonomous Robots 34, 2013; parameters and ray casting are those of its library.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from armcell.core import InputError, Octree, finite_points
from armcell.core.checks import checked, float_array

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

HALF = 1 << 15
"""Number of voxels in each direction from the origin: a map is 2^16 voxels wide (OctoMap)."""

MAX_CELLS = 1 << 28
"""Maximum number of voxels in the box around a cloud and its sensor; each takes one byte."""


@dataclass(frozen=True)
@checked()
class SensorModel:
    """Probabilities with which sensor data update an octomap (occupancy map). The defaults are OctoMap's."""

    hit: float = 0.7  # probability that a voxel with a point is occupied
    miss: float = 0.4  # probability that a voxel on a ray is occupied
    lowest: float = 0.1192  # bounds of every voxel's probability, so that later data can still change it
    highest: float = 0.971
    occupied: float = 0.5  # a voxel with at least this probability is an obstacle

    def __post_init__(self) -> None:
        if not 0 < self.lowest < self.miss < 0.5 < self.hit < self.highest < 1:
            raise InputError("a sensor model needs 0 < lowest < miss < 0.5 < hit < highest < 1")
        if not self.lowest < self.occupied < self.highest:
            raise InputError("a sensor model needs lowest < occupied < highest")


def log_odds(probability: float) -> np.float32:
    return np.float32(np.log(probability / (1 - probability)))


@dataclass(frozen=True, eq=False)
@checked()
class OccupancyMap:
    """Octomap: an immutable occupancy map of free and occupied voxels. Unknown voxels are not stored.

    `updated` returns a new map. `codes` (n,) are sorted and interleave the bits of x, y and z; `values` (n,)
    are the log-odds of these voxels.
    """

    resolution: float  # [m] edge of a voxel
    sensor: SensorModel = SensorModel()
    codes: I64 = field(default_factory=lambda: np.zeros(0, np.int64))
    values: F32 = field(default_factory=lambda: np.zeros(0, np.float32))

    def __post_init__(self) -> None:
        if not (np.isfinite(self.resolution) and self.resolution > 0):
            raise InputError(f"resolution is {self.resolution:g}, it must be a positive number of meters")

    def updated(
        self,
        points: ArrayLike,
        origin: ArrayLike,
        max_range: float = np.inf,
        only_free: ArrayLike | None = None,
    ) -> OccupancyMap:
        """Return the octomap after adding one more point cloud.

        A voxel counts once per cloud: as occupied if the voxel contains a point, otherwise as free.

        Args:
            points: (n, 3) [m] in the map's frame; points that are not finite are dropped.
            origin: (3,) [m] position of the sensor.
            max_range: rays to farther points [m] only mark free voxels up to this range.
            only_free: (m, 3) points whose rays only mark free voxels, for example points on the robot.
        Raises:
            InputError: a point or the origin is outside the map, or the cloud's box has too many voxels.
        """
        eye = float_array(origin, (3,), "origin", finite=False)
        if eye.shape != (3,) or not np.all(np.isfinite(eye)):
            raise InputError("the sensor's origin needs three finite numbers")
        if np.isnan(max_range) or max_range <= 0:
            raise InputError(f"max_range is {max_range:g} m, it must be positive")
        ends, _ = finite_points(points)
        hits = len(ends)
        if only_free is not None:
            ends = np.vstack([ends, finite_points(only_free)[0]])
        if len(ends) == 0:
            return self
        reach = np.linalg.norm(ends - eye, axis=1)
        beyond = reach > max_range
        ends[beyond] = eye + (ends[beyond] - eye) * (max_range / reach[beyond])[:, None]
        far = beyond | (np.arange(len(ends)) >= hits)
        size = self.resolution
        low = np.floor(np.minimum(ends.min(axis=0), eye) / size).astype(np.int64) - 1
        shape = np.floor(np.maximum(ends.max(axis=0), eye) / size).astype(np.int64) - low + 2
        if np.any(low < -HALF) or np.any(low + shape > HALF):
            raise InputError(
                f"a point is more than {HALF * size:g} m from the map's origin", hint="use a coarser map"
            )
        if np.prod(shape.astype(float)) > MAX_CELLS:
            raise InputError(
                f"the cloud spans {' x '.join(f'{n * size:.0f}' for n in shape)} m, too many voxels",
                hint="give max_range, or use a coarser map",
            )
        grid = np.zeros(shape, np.uint8)
        _trace(grid, low, ends, far, eye, size)
        seen, hit = _seen(grid, low)
        order = np.argsort(seen, kind="stable")
        sensor = self.sensor
        codes, values = _merged(
            self.codes, self.values, seen[order], hit[order], log_odds(sensor.hit), log_odds(sensor.miss),
            log_odds(sensor.lowest), log_odds(sensor.highest),
        )  # fmt: skip
        return replace(self, codes=codes, values=values)

    def at(self, points: ArrayLike) -> F32:
        """Return the log-odds (n,) of the octomap's voxels that contain the points (n, 3) [m]; NaN for
        unknown voxels.
        """
        keys = np.floor(
            float_array(points, (-1, 3), "points", finite=False).reshape(-1, 3) / self.resolution
        ).astype(np.int64)
        out = np.full(len(keys), np.nan, np.float32)
        inside = np.flatnonzero(np.all((keys >= -HALF) & (keys < HALF), axis=1))
        codes = voxel_codes(keys[inside])
        if len(self.codes):
            i = np.minimum(np.searchsorted(self.codes, codes), len(self.codes) - 1)
            known = self.codes[i] == codes
            out[inside[known]] = self.values[i[known]]
        return out

    def octree(self) -> Octree:
        """Return the occupied voxels of the octomap as an octree obstacle.
        Eight adjacent occupied voxels become one larger cell.
        """
        level = self.codes[self.values >= log_odds(self.sensor.occupied)]
        codes, sizes, edge = [], [], 1
        while len(level):
            first = np.flatnonzero((level[:-7] & 7 == 0) & (level[:-7] + 7 == level[7:]))
            eight = np.zeros(len(level), bool)
            eight[(first[:, None] + np.arange(8)).ravel()] = True
            codes.append(_keys(level[~eight]) * edge)
            sizes.append(np.full(len(codes[-1]), edge))
            level, edge = level[first] >> 3, edge * 2
        lowest = np.concatenate([np.zeros((0, 3), np.int64), *codes])
        edges = np.concatenate([np.zeros(0, np.int64), *sizes])
        full = np.asarray(edges * self.resolution, dtype=np.float64)
        return Octree((lowest - HALF) * self.resolution + full[:, None] / 2, full)


@njit(cache=True)
def _trace(grid, low, ends, far, eye, size):
    """Mark those voxels in an octomap's grid that sensor rays cross (bit 1) and those in which rays end
    (bit 2).

    A ray with `far` True only marks free voxels, so its end gets bit 1.

    Source: Amanatides and Woo, "A fast voxel traversal algorithm for ray tracing", Eurographics 1987.
    """
    start = np.empty(3, np.int64)
    for d in range(3):
        start[d] = np.int64(np.floor(eye[d] / size)) - low[d]
    for k in range(len(ends)):
        x, y, z = start
        ex = np.int64(np.floor(ends[k, 0] / size)) - low[0]
        ey = np.int64(np.floor(ends[k, 1] / size)) - low[1]
        ez = np.int64(np.floor(ends[k, 2] / size)) - low[2]
        dx, dy, dz = ends[k, 0] - eye[0], ends[k, 1] - eye[1], ends[k, 2] - eye[2]
        # As fractions of the ray: the exit from the voxel along each axis (t), and one voxel's length (w).
        sx, sy, sz = 1 if dx > 0 else -1, 1 if dy > 0 else -1, 1 if dz > 0 else -1
        tx = ((x + low[0] + (dx > 0)) * size - eye[0]) / dx if dx != 0 else np.inf
        ty = ((y + low[1] + (dy > 0)) * size - eye[1]) / dy if dy != 0 else np.inf
        tz = ((z + low[2] + (dz > 0)) * size - eye[2]) / dz if dz != 0 else np.inf
        wx = size / abs(dx) if dx != 0 else np.inf
        wy = size / abs(dy) if dy != 0 else np.inf
        wz = size / abs(dz) if dz != 0 else np.inf
        # One step per plane between the two voxels, so that rounding cannot lead beyond the end.
        for _ in range(abs(ex - x) + abs(ey - y) + abs(ez - z)):
            grid[x, y, z] |= 1
            if tx <= ty and tx <= tz:
                x, tx = x + sx, tx + wx
            elif ty <= tz:
                y, ty = y + sy, ty + wy
            else:
                z, tz = z + sz, tz + wz
            if (x - ex) * sx > 0 or (y - ey) * sy > 0 or (z - ez) * sz > 0:
                break
        grid[ex, ey, ez] |= 1 if far[k] else 2


@njit(cache=True)
def _spread(v):
    """Insert two zero bits after each of the low 16 bits of an integer.
    Used for the Z-order codes of an octomap.
    """
    v &= 0xFFFF
    v = (v | (v << 16)) & 0x0000FF0000FF
    v = (v | (v << 8)) & 0x00F00F00F00F
    v = (v | (v << 4)) & 0x0C30C30C30C3
    return (v | (v << 2)) & 0x249249249249


@njit(cache=True)
def _gather(v):
    v &= 0x249249249249
    v = (v | (v >> 2)) & 0x0C30C30C30C3
    v = (v | (v >> 4)) & 0x00F00F00F00F
    v = (v | (v >> 8)) & 0x0000FF0000FF
    return (v | (v >> 16)) & 0xFFFF


@njit(cache=True)
def voxel_codes(keys):
    """Return the Z-order codes (n,) of an octomap's voxels (n, 3).
    Voxel indices count from the origin of the map.
    """
    out = np.empty(len(keys), np.int64)
    for i in range(len(keys)):
        out[i] = (
            _spread(keys[i, 0] + HALF)
            | (_spread(keys[i, 1] + HALF) << 1)
            | (_spread(keys[i, 2] + HALF) << 2)
        )  # fmt: skip
    return out


@njit(cache=True)
def _keys(codes):
    """Return the octomap voxels (n, 3) for given Z-order codes (n,).
    Voxel indices count from the lowest corner of the map.
    """
    out = np.empty((len(codes), 3), np.int64)
    for i in range(len(codes)):
        for d in range(3):
            out[i, d] = _gather(codes[i] >> d)
    return out


@njit(cache=True)
def _seen(grid, low):
    """Return the Z-order codes of the marked voxels in an octomap's grid.
    For each voxel, also return whether a ray hit it.
    """
    count = 0
    for value in grid.ravel():
        count += value != 0
    codes, hit = np.empty(count, np.int64), np.empty(count, np.bool_)
    n = 0
    for i in range(grid.shape[0]):
        x = _spread(i + low[0] + HALF)
        for j in range(grid.shape[1]):
            y = _spread(j + low[1] + HALF) << 1
            for k in range(grid.shape[2]):
                if grid[i, j, k] != 0:
                    codes[n] = x | y | (_spread(k + low[2] + HALF) << 2)
                    hit[n] = grid[i, j, k] & 2
                    n += 1
    return codes, hit


@njit(cache=True)
def _merged(codes, values, seen, hit, plus, minus, lowest, highest):
    """Merge the voxels from a point cloud into an octomap.
    The log-odds of hit voxels change by `plus`, those of crossed voxels by `minus`.

    The codes of both are sorted, and so is the result.
    """
    out, odds = np.empty(len(codes) + len(seen), np.int64), np.empty(len(codes) + len(seen), np.float32)
    i, j, n = 0, 0, 0
    while i < len(codes) or j < len(seen):
        known = i < len(codes) and (j == len(seen) or codes[i] <= seen[j])
        new = j < len(seen) and (i == len(codes) or seen[j] <= codes[i])
        value = values[i] if known else np.float32(0.0)
        out[n] = codes[i] if known else seen[j]
        if new:
            value = min(max(value + (plus if hit[j] else minus), lowest), highest)
        odds[n] = value
        i, j, n = i + known, j + new, n + 1
    return out[:n].copy(), odds[:n].copy()
