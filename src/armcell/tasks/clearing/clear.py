"""Bin clearing loop: look, choose a grasp, pick, check, drop into the tray, repeat."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armcell.core import (
    Box,
    CameraImage,
    ErrorCode,
    HeightMap,
    InputError,
    NamedGoal,
    Outcome,
    PointCloud,
)
from armcell.grasping import AboveSettings, HeapGrasp, grasps_from_above, hand_of, support_surface
from armcell.model import Gripper
from armcell.perception import height_map, pieces, unusable
from armcell.planning import warm_up
from armcell.scene import CollisionObject, PlanningScene
from armcell.tasks.clearing.settings import ClearSettings
from armcell.tasks.clearing.stages import HEAP, ChooseFromHeap, ChooseReleasePoint, CloseOnHeap, OpenAbove
from armcell.tasks.clearing.steps import HELD, StillThere, empty_handed, holds
from armcell.tasks.context import StageReport, TaskContext
from armcell.tasks.recipes import planned
from armcell.tasks.search import Stage
from armcell.tasks.stages import AppendPlannedMotion, Connect, Straight
from armcell.tasks.steps import Grip, perform_all

Look = Callable[[], CameraImage]
Rectangle = tuple[tuple[float, float], tuple[float, float]]  # lowest and highest corner [m, world x and y]


@dataclass(frozen=True)
class WorkRegion:
    """A level region on which objects may lie."""

    name: str
    rectangle: Rectangle
    floor: float  # [m, world z]
    without: tuple[Rectangle, ...] = ()  # parts that other objects occupy


@dataclass(frozen=True, eq=False)
class RegionView:
    """Result of one look at a work region."""

    region: WorkRegion
    map: HeightMap
    labels: NDArray[np.int64]

    @property
    def count(self) -> int:
        """Number of seen pieces; touching objects may be one piece, one object several pieces."""
        return int(self.labels.max()) + 1


@dataclass
class ClearCounts:
    """Counters of a bin clearing run."""

    picks: int = 0  # closed grasps
    put: int = 0  # objects released over the tray
    missed: int = 0  # closed without an object, or lost during the lift
    dropped: int = 0  # lost in transit
    unplanned: int = 0  # looks without a reachable grasp
    in_a_row: int = 0  # failures since the last success
    avoid: list[tuple[float, float, float]] = field(default_factory=list)  # x, y [m], turn [rad]

    def as_dict(self) -> dict[str, Any]:
        return {k: v for k, v in self.__dict__.items() if isinstance(v, int) and k != "in_a_row"}


def clear_bin(
    ctx: TaskContext,
    gripper: Gripper,
    bin: str,
    tray: str,
    table: str,
    look: Look,
    look_at_tray: Look,
    settings: ClearSettings = ClearSettings(),
) -> Outcome:
    """Pick pieces from a bin and release them over a tray until the bin is empty.

    Uses only images and the gripper's readings. The next image shows dropped objects; objects beside bin or
    tray are picked up last.

    Args:
        bin, tray: fixed objects with a level floor, square to the world's axes.
        table: the fixed object that both stand on.
        look, look_at_tray: return the newest depth image of each.
    Returns:
        SUCCESS if no piece is visible any more, otherwise the reason for giving up. Evidence: `picks`, `put`,
        `missed`, `dropped`, `unplanned` (counts).
    Raises:
        InputError: bin or tray have no level floor or are not aligned with the world axes.
    """
    warm_up()
    s, tally = settings, ClearCounts()
    bin_region, tray_region = _inside(ctx.base, bin, s), _inside(ctx.base, tray, s)
    regions = (
        (look, bin_region),
        (look, _beside(ctx.base, bin, table, (bin, tray), s)),
        (look_at_tray, _beside(ctx.base, tray, table, (bin, tray), s)),
    )
    while True:
        if ctx.cancel.is_set():
            return _ended(tally, ErrorCode.PREEMPTED, "cancelled")
        here = _first_not_empty(ctx, regions, s)
        if isinstance(here, Outcome):
            return _ended(tally, here.code, here.message)
        if tally.in_a_row >= s.most_misses or tally.picks >= s.most_picks:
            last = f"{tally.in_a_row} picks in a row brought nothing"
            if tally.in_a_row < s.most_misses:
                last = f"{tally.picks} picks are all that was allowed"
            where = f"{here.count} {here.region.name}"
            return _ended(tally, ErrorCode.FAILURE, f"given up, {last}; pieces still seen: {where}")
        _remember_heap(ctx, here)
        grasp, outcome = _pick(ctx, gripper, here, bin, tally, s)
        if grasp is not None and outcome.ok:
            outcome = _put(ctx, gripper, grasp, here.region, bin, tray_region, look_at_tray, tally, s)
        if outcome.code is ErrorCode.PREEMPTED:
            continue
        if outcome.ok:
            tally.in_a_row, tally.avoid = 0, tally.avoid[-6:]
            continue
        tally.in_a_row += 1
        ctx.emit("note", f"clearing {bin}: {outcome.message}")
        if outcome.code in _FINAL:
            return _ended(tally, outcome.code, outcome.message)


_FINAL = (ErrorCode.UNABLE_TO_AQUIRE_SENSOR_DATA, ErrorCode.SENSOR_INFO_STALE, ErrorCode.FAILURE)


def _ended(tally: ClearCounts, code: ErrorCode, message: str) -> Outcome:
    return Outcome(code, message, tally.as_dict())


def _inside(scene: PlanningScene, name: str, settings: ClearSettings) -> WorkRegion:
    """Return the floor of a bin or tray without its walls, as a work region.

    Raises:
        InputError: it is not aligned with the world axes.
    """
    item = scene.object(name)
    frame, size_x, size_y = support_surface(item)
    R = np.abs(frame.rotation.matrix[:2, :2])
    if not np.allclose(R, np.eye(2), atol=1e-3) and not np.allclose(R, np.eye(2)[::-1], atol=1e-3):
        raise InputError(f"object {name!r} stands askew", cure="turn it square to the world's axes")
    half = R @ np.array([size_x, size_y]) / 2
    thinnest = [2 * min(s.half_extents[:2]) for s, _ in item.shapes if isinstance(s, Box)]
    wall = min(thinnest) if len(item.shapes) > 1 else 0.0
    half = half - wall - settings.resolution
    low, high = frame.translation[:2] - half, frame.translation[:2] + half
    corner = ((float(low[0]), float(low[1])), (float(high[0]), float(high[1])))
    return WorkRegion(f"in {name}", corner, float(frame.translation[2]))


def _beside(
    scene: PlanningScene, name: str, table: str, others: tuple[str, ...], s: ClearSettings
) -> WorkRegion:
    """Return the table around a bin or tray, without the objects on it, as a work region."""
    frame, size_x, size_y = support_surface(scene.object(table))
    half = np.abs(frame.rotation.matrix[:2, :2]) @ np.array([size_x, size_y]) / 2
    (x0, y0), (x1, y1) = _outline(scene.object(name), s.hand_room)
    low = np.maximum(frame.translation[:2] - half, (x0, y0))
    high = np.minimum(frame.translation[:2] + half, (x1, y1))
    corner = ((float(low[0]), float(low[1])), (float(high[0]), float(high[1])))
    without = tuple(_outline(scene.object(n), 2 * s.resolution) for n in others)
    return WorkRegion(f"beside {name}", corner, float(frame.translation[2]), without)


def _outline(item: CollisionObject, room: float) -> Rectangle:
    """Return the rectangle around an object in the world frame, enlarged by a margin [m]."""
    low, high = item.bounds()
    corners = np.array(
        [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    )
    at = item.T_world_object.apply(corners)[:, :2]
    (x0, y0), (x1, y1) = at.min(0) - room, at.max(0) + room
    return (float(x0), float(y0)), (float(x1), float(y1))


# --- looking ---
def _first_not_empty(
    ctx: TaskContext, regions: Sequence[tuple[Look, WorkRegion]], s: ClearSettings
) -> RegionView | Outcome:
    """Return the first region with visible pieces.

    Return an outcome instead if all regions are empty or an image is missing.
    """
    for look, region in regions:
        seen = _look(ctx, look, region, s)
        if isinstance(seen, Outcome) or seen.count:
            return seen
    return Outcome(ErrorCode.SUCCESS)


def _look(ctx: TaskContext, look: Look, region: WorkRegion, s: ClearSettings) -> RegionView | Outcome:
    """Return the view of a region in a new image, or an outcome if there is no usable image."""
    report = StageReport(f"look {region.name}", started_s=ctx.driver.now)
    ctx.emit("stage", report.name, phase="begin")
    image = look()
    trouble = unusable(image, s.max_age, ctx.driver.now)
    report.ok, report.error = trouble is None, "" if trouble is None else trouble.message
    ctx.reports.append(report)
    ctx.emit("stage", report.name, phase="end", ok=report.ok)
    if trouble is not None:
        return trouble
    (x0, y0), (x1, y1) = region.rectangle
    room = s.hand_room
    low, high = (x0 - room, y0 - room), (x1 + room, y1 + room)
    seen = height_map(image, ctx.scene(), low, high, region.floor, s.resolution)
    inside = seen.cells_within(*region.rectangle)
    for other in region.without:
        inside &= ~seen.cells_within(*other)
    return RegionView(region, seen, pieces(seen, inside, region.floor + s.above_floor))


def _remember_heap(ctx: TaskContext, seen: RegionView) -> None:
    """Add the seen pieces to the planning scene as a point cloud."""
    points = seen.map.at(np.argwhere(seen.labels >= 0)[::3])
    cloud = CollisionObject.single(HEAP, PointCloud(points, 2 * seen.map.resolution))

    def remembered(scene: PlanningScene) -> PlanningScene:
        scene = scene.without_object(HEAP) if HEAP in scene.objects else scene
        return scene.with_object(cloud)

    ctx.change_scene(remembered)


# --- moving ---
def _pick(
    ctx: TaskContext, gripper: Gripper, here: RegionView, bin: str, tally: ClearCounts, s: ClearSettings
) -> tuple[HeapGrasp | None, Outcome]:
    """Lift a piece with the best reachable grasp; None if no grasp was tried."""
    hand, grasps = hand_of(ctx.base.model, gripper), []
    for how in (s.grasps, _closer(s.grasps, 2), _closer(s.grasps, 3)):
        grasps = grasps_from_above(here.map, here.labels, here.region.floor, hand, s.force, how, tally.avoid)
        if grasps:
            break
    if not grasps:
        tally.unplanned += 1
        text = f"{here.count} pieces {here.region.name}, the hand fits around none of them"
        return None, Outcome(ErrorCode.PLANNING_FAILED, text)
    t = ctx.settings
    stages: list[Stage] = [
        ChooseFromHeap(grasps, gripper, t.near, t.approach_distance),
        Connect("move to pre-grasp", gripper.arm_group, t.free, target="pre_grasp"),
        AppendPlannedMotion("approach", "after_approach"),
        CloseOnHeap(gripper, here.region.floor, t.grasp_settle, s.thinnest),
        Straight("lift", gripper.arm_group, gripper.tcp_link, t.near, (0.0, 0.0, s.lift),
                 allow=((HELD, (HEAP, bin)), (HEAP, gripper.hand_links))),
    ]  # fmt: skip
    solution, outcome = planned(ctx, stages, f"pick {here.region.name}")
    if solution is None:
        tally.unplanned += 1
        return None, outcome
    grasp: HeapGrasp = solution.data["grasp"]
    tally.picks += 1
    outcome = perform_all(ctx, (*solution.steps, StillThere(gripper, s.thinnest)))
    if not outcome.ok and outcome.code is not ErrorCode.PREEMPTED:
        tally.missed += 1
        at, y = grasp.T_object_tcp.translation, grasp.T_object_tcp.rotation.matrix[:, 1]
        tally.avoid.append((float(at[0]), float(at[1]), float(np.arctan2(y[1], y[0]))))
        _give_way(ctx, gripper, grasp.opening, bin, s)
    return grasp, outcome


def _closer(settings: AboveSettings, times: int) -> AboveSettings:
    """Return settings for pieces near a wall: less margin, more orientations, corner contacts."""
    return replace(
        settings,
        room=settings.room / times,
        turns=times * settings.turns,
        least_touch=settings.least_touch / 2,
    )


def _give_way(ctx: TaskContext, gripper: Gripper, opening: float, bin: str, s: ClearSettings) -> None:
    """Open the fingers, retreat straight up as far as possible, then leave the camera's view.

    The fingers open only if they press on an object, and at most to their opening before the grasp: the hand
    or the neighboring pieces may have moved since.
    """
    empty_handed(ctx)
    t, reading = ctx.settings, ctx.driver.gripper(gripper.name)
    if holds(reading, s.thinnest):
        width = min(reading.width + t.release_margin, opening)
        Grip("open", gripper, width, gripper.max_force, t.release_settle).perform(ctx)
    touching = ((HEAP, gripper.hand_links), (bin, gripper.hand_links))
    up = Straight("retreat", gripper.arm_group, gripper.tcp_link, t.near, (0.0, 0.0, s.lift), allow=touching)
    solution, _ = planned(ctx, [up], "retreat")
    if solution is not None:
        perform_all(ctx, solution.steps)
    _out_of_view(ctx, gripper)


def _out_of_view(ctx: TaskContext, gripper: Gripper) -> None:
    """Move the arm to its first named state that is reachable."""
    for name in ctx.base.model.named_states.get(gripper.arm_group, {}):
        stage = Connect(f"move to {name}", gripper.arm_group, ctx.settings.free, goal=NamedGoal(name))
        solution, _ = planned(ctx, [stage], f"move to {name}")
        if solution is not None:
            perform_all(ctx, solution.steps)
            return


def _put(
    ctx: TaskContext, gripper: Gripper, grasp: HeapGrasp, source: WorkRegion, bin: str, tray: WorkRegion,
    look: Look, tally: ClearCounts, s: ClearSettings,
) -> Outcome:  # fmt: skip
    """Release the held object at the lowest point of the tray; FAILURE if the tray is full."""
    seen = _look(ctx, look, tray, s)
    if isinstance(seen, Outcome):
        return seen
    spots = _lowest(seen, s)
    if not spots or spots[0][2] > tray.floor + s.pile:
        _lay_back(ctx, gripper, grasp, bin, s)
        lowest = f"the lowest place is {1000 * (spots[0][2] - tray.floor):.0f} mm up, at most "
        room = f"{lowest}{1000 * s.pile:.0f} mm are allowed" if spots else "it is too small"
        text = f"full: no room {tray.name}, {room}; what was held lies {source.name} again"
        return Outcome(ErrorCode.FAILURE, f"{text} (empty the tray, or a greater `pile`)")
    hang = float(grasp.T_object_tcp.translation[2]) - source.floor + s.gap
    t = ctx.settings
    stages: list[Stage] = [
        ChooseReleasePoint(spots, hang, gripper, t.near, t.lower_distance),
        Connect("move to tray", gripper.arm_group, t.carry, target="pre_place"),
        AppendPlannedMotion("lower", "after_lower"),
        OpenAbove(gripper, t.release_margin, t.release_settle, s.thinnest),
        Straight("retreat", gripper.arm_group, gripper.tcp_link, t.near, (0.0, 0.0, t.retreat_distance)),
    ]  # fmt: skip
    solution, outcome = planned(ctx, stages, f"put {tray.name}")
    if solution is not None:
        outcome = perform_all(ctx, solution.steps)
        if outcome.ok:
            tally.put += 1
            return outcome
    if outcome.code is not ErrorCode.PREEMPTED:
        reading = ctx.driver.gripper(gripper.name)
        tally.dropped += not holds(reading, s.thinnest)
        empty_handed(ctx)
        Grip("open", gripper, grasp.opening, gripper.max_force, t.release_settle).perform(ctx)
        _out_of_view(ctx, gripper)
    return outcome


def _lay_back(ctx: TaskContext, gripper: Gripper, grasp: HeapGrasp, bin: str, s: ClearSettings) -> None:
    """Lower the object along its lift path and release it."""
    touching = ((HELD, (HEAP, bin)), (HEAP, gripper.hand_links))
    down = (0.0, 0.0, s.gap - s.lift)
    stage = Straight("lay back", gripper.arm_group, gripper.tcp_link, ctx.settings.near, down, allow=touching)
    solution, _ = planned(ctx, [stage], "lay back")
    if solution is not None:
        perform_all(ctx, solution.steps)
    _give_way(ctx, gripper, grasp.opening, bin, s)


def _lowest(tray: RegionView, s: ClearSettings, count: int = 12) -> list[tuple[float, float, float]]:
    """Return release points of the tray as (x, y, highest z nearby), lowest first.

    Points of equal height are sorted by their distance from objects, farthest first.
    """
    from scipy.ndimage import distance_transform_edt, maximum_filter

    map, r = tray.map, s.spot_radius
    (x0, y0), (x1, y1) = tray.region.rectangle
    size = 2 * int(np.ceil(r / map.resolution)) + 1
    inside = map.cells_within(*tray.region.rectangle)
    heights = np.where(inside, map.heights, tray.region.floor)
    under = maximum_filter(heights, size=size)
    room = np.asarray(distance_transform_edt(tray.labels < 0)) * map.resolution
    middle = map.cells_within((x0 + r, y0 + r), (x1 - r, y1 - r))
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
