"""Kernel arrays of all world objects, updated only for changed objects."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.box_tree import box_tree
from armcell.collision.kernel.object_tables import (
    BLOCKS,
    CLOUDS,
    NUMBERS,
    PIECES,
    PLANES,
    POINTS,
    ROWS,
    SHAPES,
    object_tables,
)
from armcell.scene import CollisionObject

I64 = NDArray[np.int64]

COLUMN = {name: k for k, (first, others) in enumerate(ROWS.items()) for name in (first, *others)}
KEPT = 8  # worlds


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
        """Return at which row the data of each object starts in each kernel table of the world, as an array
        (objects + 1, len(ROWS)).
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


_lock = threading.RLock()
_recent: deque[World] = deque(maxlen=KEPT)


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
    """Update the kernel's arrays for a changed world. The rows of unchanged objects are copied."""
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
        tables[name] = np.concatenate(found) if found else source[:0]
    counts = [
        made[b].counts if k < 0 else last.counts[k : k + n]
        for b, k, n in zip(begin, first, count, strict=True)
    ]
    return World(names, items, tables, np.concatenate([NOTHING.counts, *counts]))


def _runs(known: I64) -> tuple[I64, I64]:
    """Split the objects of a changed world into runs that are copied together: consecutive indices in the
    last world's arrays, or new objects (-1).
    """
    new = known < 0
    joins = np.where(new[1:], new[:-1], ~new[:-1] & (np.diff(known) == 1))
    begin = np.concatenate([np.zeros(min(len(known), 1), np.int64), np.flatnonzero(~joins) + 1])
    return begin, np.append(begin[1:], len(known))[: len(begin)]


NOTHING = World((), (), *object_tables(()))
