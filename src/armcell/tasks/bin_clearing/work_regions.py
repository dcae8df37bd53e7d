"""Work regions of bin clearing: where pieces may lie, and how a depth camera sees them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from armcell.core import Box, CameraImage, ErrorCode, HeightMap, InputError, Outcome, PointCloud
from armcell.grasping import support_surface
from armcell.perception import check_image, height_map, label_pieces
from armcell.scene import CollisionObject, PlanningScene
from armcell.tasks.bin_clearing.settings import BinClearingSettings
from armcell.tasks.bin_clearing.stages import HEAP
from armcell.tasks.context import StageReport, TaskContext

Look = Callable[[], CameraImage]
"""Returns the newest depth image of a camera."""
Rectangle = tuple[tuple[float, float], tuple[float, float]]
"""Lowest and highest corner [m, world x and y]."""


@dataclass(frozen=True)
class Container:
    """Bin or tray beside which objects may rest: its outline, the inside of its walls, and the heights of its
    floor and walls [m, world z].
    """

    outline: Rectangle
    inside: Rectangle
    floor: float
    top: float


@dataclass(frozen=True)
class WorkRegion:
    """Work region of bin clearing: a level area on which objects may rest."""

    name: str
    rectangle: Rectangle
    floor: float  # [m, world z]
    without: tuple[Container, ...] = ()  # containers on the level area
    container: Container | None = None  # whose floor the level area is; pieces may lean over its walls


@dataclass(frozen=True, eq=False)
class RegionView:
    """Height map and object labels of a work region, computed from one depth image. Bin clearing searches the
    work region for objects.
    """

    region: WorkRegion
    map: HeightMap
    labels: NDArray[np.int64]
    cells: NDArray[np.bool_]  # of the map, over the work region
    seen_from: NDArray[np.float64]  # (3,) [m, world] position of the camera
    is_old: bool = False  # an arm has touched pieces since the image

    @property
    def count(self) -> int:
        """Return the number of objects that are visible in a work region.

        Touching objects may count as one object, and one object as several.
        """
        return int(self.labels.max()) + 1

    @property
    def corners(self) -> NDArray[np.float64]:
        """Return the corners (5, 3) [m, world] of the pyramid through which the camera sees the region."""
        return corners_of_view(self.region, self.seen_from)

    def without(self, places: Sequence[NDArray[np.float64]], radius: float) -> RegionView:
        """Return the view without the pieces that a hand may have moved since the image: all cells within
        `radius` [m] of the given places (x, y) [m, world]. The height map does not change.
        """
        labels, at = self.labels.copy(), np.argwhere(self.labels >= 0)
        xy = self.map.at(at)[:, :2]
        for place in places:
            labels[tuple(at[np.linalg.norm(xy - place, axis=1) < radius].T)] = -1
        return replace(self, labels=_renumbered(labels), is_old=True)


def floor_of(scene: PlanningScene, name: str, settings: BinClearingSettings) -> WorkRegion:
    """Return the floor of a bin or tray, without the walls, as a work region.

    Raises:
        InputError: it is not aligned with the world axes.
    """
    item = scene.object(name)
    frame, size_x, size_y = support_surface(item)
    R = np.abs(frame.rotation.matrix[:2, :2])
    if not np.allclose(R, np.eye(2), atol=1e-3) and not np.allclose(R, np.eye(2)[::-1], atol=1e-3):
        raise InputError(f"object {name!r} stands askew", hint="turn it square to the world's axes")
    half = R @ np.array([size_x, size_y]) / 2
    thinnest = [2 * min(s.half_extents[:2]) for s, _ in item.shapes if isinstance(s, Box)]
    wall = min(thinnest) if len(item.shapes) > 1 else 0.0
    half = half - wall - settings.resolution
    low, high = frame.translation[:2] - half, frame.translation[:2] + half
    corner = ((float(low[0]), float(low[1])), (float(high[0]), float(high[1])))
    floor = float(frame.translation[2])
    low, high = item.bounds()
    top = max(float(item.T_world_object.apply(np.array([c]))[0, 2]) for c in (low, high))
    container = Container(_outline(item, 2 * settings.resolution), corner, floor, top)
    return WorkRegion(f"in {name}", corner, floor, container=container)


def table_around(
    scene: PlanningScene, name: str, table: str, others: tuple[str, ...], s: BinClearingSettings
) -> WorkRegion:
    """Return the table surface around a bin or tray as a work region,
    without the areas of the other objects on the table, and without its border, beside which the camera may
    see an edge.

    The regions around two neighbors overlap, because the arm may hide the space between from one camera.
    """
    frame, size_x, size_y = support_surface(scene.object(table))
    half = np.abs(frame.rotation.matrix[:2, :2]) @ np.array([size_x, size_y]) / 2 - 2 * s.resolution
    (x0, y0), (x1, y1) = _outline(scene.object(name), s.beside)
    low = np.maximum(frame.translation[:2] - half, (x0, y0))
    high = np.minimum(frame.translation[:2] + half, (x1, y1))
    corner = ((float(low[0]), float(low[1])), (float(high[0]), float(high[1])))
    containers = (floor_of(scene, n, s).container for n in others)
    without = tuple(c for c in containers if c is not None)
    return WorkRegion(f"beside {name}", corner, float(frame.translation[2]), without)


def _outline(item: CollisionObject, room: float) -> Rectangle:
    """Return the rectangle of a bin or tray in the world frame,
    enlarged by a margin [m], to bound a work region.
    """
    low, high = item.bounds()
    corners = np.array(
        [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    )
    at = item.T_world_object.apply(corners)[:, :2]
    (x0, y0), (x1, y1) = at.min(0) - room, at.max(0) + room
    return (float(x0), float(y0)), (float(x1), float(y1))


def first_not_empty(
    ctx: TaskContext, regions: Sequence[tuple[Look, WorkRegion]], s: BinClearingSettings
) -> RegionView | Outcome:
    """Look at the work regions one after the other, and return the view of the first region that contains
    visible objects.

    If all regions are empty, the result is an outcome with SUCCESS. If an image is unusable, the result is
    the failure.
    """
    for look, region in regions:
        seen = view_region(ctx, look, region, s)
        if isinstance(seen, Outcome) or seen.count:
            return seen
    return Outcome(ErrorCode.SUCCESS)


def view_region(
    ctx: TaskContext, look: Look, region: WorkRegion, s: BinClearingSettings
) -> RegionView | Outcome:
    """Take a new image of a work region for bin clearing. Return the region's height map with the visible
    pieces, or a failure outcome if the image is unusable.

    The image is taken when no other arm hides the region.
    """
    report = StageReport(f"look {region.name}", started_s=ctx.driver.now)
    ctx.emit("stage", report.name, phase="begin")
    image = look()
    while ctx.await_view(corners_of_view(region, image.T_world_camera.translation)):
        image = look()
    trouble = check_image(image, s.max_age, ctx.driver.now)
    report.ok, report.error = trouble is None, "" if trouble is None else trouble.message
    ctx.reports.append(report)
    ctx.emit("stage", report.name, phase="end", ok=report.ok)
    if trouble is not None:
        return trouble
    (x0, y0), (x1, y1) = region.rectangle
    room = s.hand_room
    low, high = (x0 - room, y0 - room), (x1 + room, y1 + room)
    seen = height_map(image, ctx.whole_scene(), low, high, region.floor, s.resolution)
    inside = seen.cells_within(*region.rectangle)
    for other in region.without:
        inside &= ~seen.cells_within(*other.outline)
    labels = label_pieces(seen, inside, region.floor + s.above_floor)
    if region.container is not None:
        labels = _with_leaning(seen, inside, labels, region.container, s.above_floor)
    for other in region.without:
        labels = _without_contained(seen, labels, other, s.above_floor)
    # the fingertips may go 3 mm above the floor, less than the noise of a camera
    bare = inside & (labels < 0) & (seen.heights <= region.floor + s.above_floor)
    level = replace(seen, heights=np.where(bare, region.floor, seen.heights))
    return RegionView(region, level, labels, inside, image.T_world_camera.translation)


def corners_of_view(region: WorkRegion, camera: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the corners (5, 3) [m, world] of the pyramid through which a camera sees a work region."""
    (x0, y0), (x1, y1) = region.rectangle
    ground = [(x, y, region.floor) for x in (x0, x1) for y in (y0, y1)]
    return np.vstack([camera, ground])


def _with_leaning(
    seen: HeightMap, inside: NDArray[np.bool_], labels: NDArray[np.int64], container: Container, above: float
) -> NDArray[np.int64]:
    """Return the labels of a container's pieces, extended to the parts of the pieces above and beyond its
    walls: the hand may grasp these parts.
    """
    where = (labels >= 0) | (~inside & (seen.heights > container.top + above))
    objects = label_pieces(seen, where, -np.inf)
    found = labels.copy()
    for k in np.unique(objects[(objects >= 0) & (labels >= 0)]):
        cells = objects == k
        found[cells & ~inside] = np.bincount(labels[cells & (labels >= 0)]).argmax()
    return found


def _without_contained(
    seen: HeightMap, labels: NDArray[np.int64], container: Container, above: float
) -> NDArray[np.int64]:
    """Remove pieces from the labels of a work region: pieces of an object that is in a container and leans
    over its wall. Return the remaining labels.

    The object counts as contained if at least half of what the camera sees of it is over the container.
    """
    over, inside = seen.cells_within(*container.outline), seen.cells_within(*container.inside)
    wall = over & ~inside
    where = labels >= 0
    where |= inside & (seen.heights > container.floor + above)
    where |= wall & (seen.heights > container.top + above)
    objects = label_pieces(seen, where, -np.inf)
    found = labels.copy()
    for k in np.unique(objects[(objects >= 0) & (labels >= 0)]):
        cells = objects == k
        if np.count_nonzero(cells & over) >= np.count_nonzero(cells & ~over):
            found[np.isin(labels, labels[cells & (labels >= 0)])] = -1
    return _renumbered(found)


def _renumbered(labels: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the labels of pieces with the numbers from 0 on, after some pieces have lost all cells."""
    found, kept = labels.copy(), labels >= 0
    found[kept] = np.unique(labels[kept], return_inverse=True)[1]
    return found


def add_heap(ctx: TaskContext, seen: RegionView, picked: int = -1) -> None:
    """Add the visible objects of a work region to the planning scene, as one point cloud.

    Args:
        picked: number of the piece that the hand has picked since the image; its points move to the floor.
    """
    cells = np.argwhere(seen.labels >= 0)[::3]
    points = seen.map.at(cells)
    points[seen.labels[cells[:, 0], cells[:, 1]] == picked, 2] = seen.region.floor
    cloud = CollisionObject.single(HEAP, PointCloud(points, 2 * seen.map.resolution))

    def remembered(scene: PlanningScene) -> PlanningScene:
        scene = scene.without_object(HEAP) if HEAP in scene.objects else scene
        return scene.with_object(cloud)

    ctx.change_scene(remembered)


def lowest_points(
    tray: RegionView, s: BinClearingSettings, extent: float = 0.0, count: int = 12
) -> list[tuple[float, float, float]]:
    """Return points (x, y, highest z nearby) over the tray at which
    bin clearing may release an object, lowest first.

    Points of equal height are sorted by their distance from objects, farthest first.

    Args:
        extent: [m] of the object from the hand's center, sideways and upward. The object keeps this distance
            from the walls if the tray is large enough: otherwise it may fall over a wall.
    """
    from scipy.ndimage import distance_transform_edt, maximum_filter

    map, r = tray.map, s.spot_radius
    (x0, y0), (x1, y1) = tray.region.rectangle
    size = 2 * int(np.ceil(r / map.resolution)) + 1
    inside = map.cells_within(*tray.region.rectangle)
    heights = np.where(inside, map.heights, tray.region.floor)
    under = maximum_filter(heights, size=size)
    room = np.asarray(distance_transform_edt(tray.labels < 0)) * map.resolution
    margin = max(r, min(extent, (x1 - x0) / 4, (y1 - y0) / 4))
    middle = map.cells_within((x0 + margin, y0 + margin), (x1 - margin, y1 - margin))
    cells = np.argwhere(middle)
    value = under[middle].round(2) - 0.01 * np.minimum(room[middle], 0.1)
    found: list[tuple[float, float, float]] = []
    for k in np.argsort(value, kind="stable"):
        x, y, _ = map.at(cells[k : k + 1])[0]
        if all(np.hypot(x - a, y - b) > r for a, b, _ in found):
            found.append((float(x), float(y), float(under[tuple(cells[k])])))
            if len(found) == count:
                break
    return found
