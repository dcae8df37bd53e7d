"""Kernel arrays of world objects: shapes in world coordinates, updated only for changed objects."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.box_tree import HUGE, box_tree
from armcell.collision.kernel.cloud_arrays import Cloud, cloud_of
from armcell.collision.kernel.convex_pieces import pieces_of, solid
from armcell.collision.kernel.simd import L
from armcell.core import Mesh, Plane, Shape
from armcell.core.geometry import local_bounds
from armcell.scene import CollisionObject

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

ROWS = {
    "shape_kind": ("shape_pose", "shape_size", "planes_end", "pieces_end", "shape_cloud", "low", "high"),
    "planes": (),
    "piece_kind": ("piece_size", "piece_pose", "piece_ball", "piece_points"),
    "points": (),
    "points32": (),
    "cloud": (),
    "cloud_boxes": ("cloud_child",),
    "cloud_parts": (),
}
"""Tables of objects, and for each the other tables that have as many rows. Indices in an object's tables
count from the first row of the object. Beside tables of a `Pack` there are:

- `planes_end`, `pieces_end` (o,): end of each shape's planes and exact pieces,
- `low`, `high` (o, 3): corners of the shapes' bounding boxes in the world [m].
"""

SHAPES, PLANES, PIECES, POINTS, BLOCKS_OF_POINTS, CLOUDS, BLOCKS, NUMBERS = range(len(ROWS))
NO_PLANES = np.zeros((0, 4))
NO_CLOUDS: dict[str, NDArray] = {
    "cloud": np.zeros((0, 4), np.int32),
    "cloud_boxes": np.zeros((0, 6, L), np.float32),
    "cloud_child": np.zeros((0, L), np.int32),
    "cloud_parts": np.zeros(0, np.float32),
}
COLUMN = {name: k for k, (first, others) in enumerate(ROWS.items()) for name in (first, *others)}
KEPT = 8  # worlds
_lock = threading.RLock()
_recent: deque[World] = deque(maxlen=KEPT)


class ObjectTables(NamedTuple):
    """Kernel tables of several world objects, with the number of table rows of each object."""

    tables: dict[str, NDArray]
    counts: I64  # (objects, len(ROWS))


class _Solid(NamedTuple):
    """Convex shape of a world object, from which the kernel's world arrays are built. A point cloud or
    nonconvex mesh is represented by its bounding box.
    """

    owner: int
    shape: Shape
    T: F64  # (4, 4) T_world_shape
    cloud: Cloud | None


def object_tables(items: Sequence[CollisionObject]) -> ObjectTables:
    """Build the rows that world objects occupy in the tables of the kernel's world arrays."""
    solids = [s for owner, item in enumerate(items) for s in _solids(owner, item)]
    owner = np.array([s.owner for s in solids], np.int64)
    T = np.array([s.T for s in solids]).reshape(-1, 4, 4)
    kinds = [solid(s.shape) for s in solids]
    box = np.array([_world_box(s.shape, s.T) for s in solids]).reshape(-1, 2, 3)
    planes = [_hull_planes(s.shape) if isinstance(s.shape, Mesh) else NO_PLANES for s in solids]
    pieces = pieces_of([(s.shape, s.T) for s in solids])
    clouds = [s.cloud for s in solids if s.cloud is not None]
    cloud_owner = np.array([s.owner for s in solids if s.cloud is not None], np.int64)

    def rows(owners: I64, sizes: Sequence[int] | I64 | None = None) -> I64:
        """Return how many rows each world object has in the kernel's tables."""
        return np.bincount(owners, sizes, len(items)).astype(np.int64)

    plane_rows = [len(p) for p in planes]
    lanes = -(-pieces.corners.count.astype(np.int64) // L)  # every solid is one piece
    counts = [
        rows(owner), rows(owner, plane_rows), rows(owner), rows(owner, lanes * L), rows(owner, lanes),
        rows(cloud_owner), rows(cloud_owner, [len(c.boxes) for c in clouds]),
        rows(cloud_owner, [c.parts.size for c in clouds]),
    ]  # fmt: skip
    number = _within(cloud_owner, np.ones(len(clouds), np.int64))
    cloud = np.full(len(solids), -1, np.int32)
    cloud[[s.cloud is not None for s in solids]] = number
    first_point = pieces.tables["piece_points"].copy()
    first_point[:, 0] = _within(owner, lanes * L)
    tables = {
        "shape_kind": np.array([kind for kind, _ in kinds], np.int32),
        "shape_pose": np.linalg.inv(T)[:, :3].reshape(-1, 12).astype(np.float32),
        "shape_size": np.array([size for _, size in kinds], np.float32).reshape(-1, 3),
        "planes_end": (_within(owner, plane_rows) + plane_rows).astype(np.int32),
        "pieces_end": (_within(owner, np.ones_like(owner)) + 1).astype(np.int32),
        "shape_cloud": cloud,
        "low": box[:, 0],
        "high": box[:, 1],
        "planes": np.concatenate([NO_PLANES, *planes]).astype(np.float32),
        **pieces.tables,
        "piece_points": first_point,
        **_cloud_tables(clouds, cloud_owner),
    }
    return ObjectTables(tables, np.column_stack(counts))


def _within(owner: I64, sizes: I64 | Sequence[int]) -> I64:
    """Return, for each entry of a kernel table, the offset of the entry within the world object that owns it:
    the total size of the object's earlier entries.

    The owners are sorted.
    """
    if len(owner) == 0:
        return np.zeros(0, np.int64)
    before = np.cumsum(sizes) - sizes
    return (before - before[owner.searchsorted(owner)]).astype(np.int64)


def _solids(owner: int, item: CollisionObject) -> list[_Solid]:
    found, T_world_object = [], item.T_world_object.matrix
    for shape, T_object_shape in item.shapes:
        T, cloud = T_world_object @ T_object_shape.matrix, cloud_of(shape)
        if cloud is None:
            found.append(_Solid(owner, shape, T, None))
        elif not cloud.empty:
            found.append(_Solid(owner, cloud.box, T @ cloud.T_shape_box, cloud))
    return found


def _cloud_tables(clouds: Sequence[Cloud], owner: I64) -> dict[str, NDArray]:
    if not clouds:
        return NO_CLOUDS
    blocks = _within(owner, [len(c.boxes) for c in clouds])
    numbers = _within(owner, [c.parts.size for c in clouds])
    rows = [(c.kind, b, n, c.closed) for c, b, n in zip(clouds, blocks, numbers, strict=True)]
    return {
        "cloud": np.array(rows, np.int32).reshape(-1, 4),
        "cloud_boxes": _joined([c.boxes for c in clouds]),
        "cloud_child": _joined([c.child for c in clouds]),
        "cloud_parts": _joined([c.parts.ravel() for c in clouds]),
    }


def _joined(arrays: Sequence[NDArray]) -> NDArray:
    """Return the rows of all arrays. Where a single array has rows, they are not copied, because clouds are
    large; but a part of a table is copied, because it would keep the whole table in memory.
    """
    filled = [a for a in arrays if len(a)]
    if len(filled) == 1 and (filled[0].base is None or filled[0].base.size == filled[0].size):
        return filled[0]
    return np.concatenate(arrays)


@lru_cache(maxsize=1024)
def _hull_planes(mesh: Mesh) -> F64:
    """Return the planes (n, 4) of a world mesh's convex hull as outward normals and offsets,
    for the collision kernel.
    """
    from scipy.spatial import ConvexHull

    equations = ConvexHull(mesh.vertices).equations  # n x + d <= 0 inside
    _, index = np.unique(np.round(equations, 6), axis=0, return_index=True)
    planes = equations[np.sort(index)]
    return np.column_stack([planes[:, :3], -planes[:, 3]])


def _world_box(shape: Shape, T: F64) -> tuple[F64, F64]:
    if isinstance(shape, Plane):
        return np.full(3, -HUGE), np.full(3, HUGE)
    center, half = local_bounds(shape)
    center = T[:3, :3] @ center + T[:3, 3]
    half = np.abs(T[:3, :3]) @ half
    return center - half, center + half


@dataclass(frozen=True, eq=False)
class World:
    """Kernel arrays that describe the world: the table rows of all world objects of a scene.

    Attributes:
        names: names of the objects.
        objects: the objects, in the order of `names`.
        tables: the objects' tables, joined; indices count from the first row of their own object.
        counts: (objects, len(ROWS)) number of rows that each object has in the tables of `ROWS`.
    """

    names: tuple[str, ...]
    objects: tuple[CollisionObject, ...]
    tables: dict[str, NDArray]
    counts: I64

    @cached_property
    def starts(self) -> I64:
        """Return the index of each world object's first row in each kernel table, as an array (objects + 1,
        len(ROWS)). The last row holds the total number of rows per table.
        """
        return np.vstack([np.zeros((1, len(ROWS)), np.int64), np.cumsum(self.counts, axis=0)])

    @cached_property
    def index(self) -> dict[CollisionObject, int]:
        return dict(zip(self.objects, range(len(self.objects)), strict=True))

    @cached_property
    def arrays(self) -> dict[str, NDArray]:
        """Return those arrays of a `Pack` that depend only on the world objects."""
        tables, starts = self.tables, self.starts
        boxes, child = box_tree(tables["low"], tables["high"])
        of_shape = np.repeat(np.arange(len(self.objects)), self.counts[:, SHAPES])
        cloud = tables["shape_cloud"]
        first = np.repeat(starts[:-1, [BLOCKS, NUMBERS]], self.counts[:, CLOUDS], axis=0)
        clouds = tables["cloud"].copy()
        clouds[:, 1:3] += first.astype(np.int32)
        kept = ("shape_kind", "shape_pose", "shape_size", "planes")
        return {name: tables[name] for name in (*kept, "cloud_boxes", "cloud_child", "cloud_parts")} | {
            "shape_object": of_shape.astype(np.int32),
            "shape_planes": self._ends("planes_end", PLANES, of_shape),
            "shape_cloud": np.where(cloud < 0, cloud, cloud + starts[of_shape, CLOUDS]).astype(np.int32),
            "boxes": boxes,
            "child": child,
            "cloud": clouds,
        }

    @cached_property
    def shape_pieces(self) -> NDArray[np.int32]:
        """Return the index (shapes + 1,) at which the convex pieces of
        each world shape start in the kernel's arrays.
        """
        of_shape = np.repeat(np.arange(len(self.objects)), self.counts[:, SHAPES])
        return self._ends("pieces_end", PIECES, of_shape)

    @cached_property
    def pieces(self) -> dict[str, NDArray]:
        """Return the convex pieces of all world objects as tables in
        the array format of the collision kernel.
        """
        names = ("piece_kind", "piece_size", "piece_pose", "piece_ball", "points", "points32")
        first = np.repeat(self.starts[:-1, POINTS], self.counts[:, PIECES])
        points = self.tables["piece_points"].copy()
        points[:, 0] += first.astype(np.int32)
        return {name: self.tables[name] for name in names} | {"piece_points": points}

    def _ends(self, table: str, column: int, of_shape: I64) -> NDArray[np.int32]:
        ends = self.tables[table] + self.starts[of_shape, column]
        return np.concatenate([[0], ends]).astype(np.int32)


def world_of(objects: Mapping[str, CollisionObject]) -> World:
    """Return the kernel arrays for all world objects of a scene. The arrays of the most recent scenes are
    cached.

    Arrays of a new world are copied from an earlier one where its objects are the same, so that a change of a
    few among thousands of objects costs little.
    """
    names, items = tuple(objects), tuple(objects.values())
    with _lock:
        for world in _recent:
            if world.objects == items and world.names == names:
                _recent.remove(world)
                break
        else:
            world = _updated(_similar(items), names, items)
        _recent.appendleft(world)
        return world


def _similar(items: tuple[CollisionObject, ...]) -> World:
    """Return the cached kernel arrays of a similar world,
    which has many objects in common with the given world.

    It is the first world with at least half of the objects, or else the one with the most of them.
    """
    best, most = NOTHING, 0
    for world in _recent:
        known = sum(map(world.index.__contains__, items))
        if known > most:
            best, most = world, known
        if 2 * known >= len(items):
            break
    return best


def _updated(last: World, names: tuple[str, ...], items: tuple[CollisionObject, ...]) -> World:
    """Update the kernel's arrays after a change of the world. Only the rows of new or changed objects are
    computed; the others are copied.
    """
    known = np.fromiter((last.index.get(item, -1) for item in items), np.int64, len(items))
    begin, end = _runs(known)
    first, count = known[begin], end - begin
    made = {b: object_tables(items[b:e]) for b, e, k in zip(begin, end, first, strict=True) if k < 0}
    low, high = last.starts[first].T, last.starts[first + np.where(first < 0, 0, count)].T
    tables: dict[str, NDArray] = {}
    for name, column in COLUMN.items():
        source = last.tables[name]
        rows = zip(begin, first, low[column].tolist(), high[column].tolist(), strict=True)
        found = [made[b].tables[name] if k < 0 else source[lo:hi] for b, k, lo, hi in rows]
        tables[name] = _joined(found) if found else source[:0]
    counts = [
        made[b].counts if k < 0 else last.counts[k : k + n]
        for b, k, n in zip(begin, first, count, strict=True)
    ]
    return World(names, items, tables, np.concatenate([NOTHING.counts, *counts]))


def _runs(known: I64) -> tuple[I64, I64]:
    """Split the world objects of a changed scene into runs. The objects of a run are either all new (index
    -1), or consecutive in the kernel's previous world arrays, so that they are copied as one block.
    """
    new = known < 0
    joins = np.where(new[1:], new[:-1], ~new[:-1] & (np.diff(known) == 1))
    begin = np.concatenate([np.zeros(min(len(known), 1), np.int64), np.flatnonzero(~joins) + 1])
    return begin, np.append(begin[1:], len(known))[: len(begin)]


NOTHING = World((), (), *object_tables(()))
