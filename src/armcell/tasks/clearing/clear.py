"""Clearing a bin of things nobody knows: look, choose, pick, check, put away, look again."""

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
from armcell.tasks.clearing.stages import HEAP, ChooseFromHeap, ChooseSpot, CloseOnHeap, OpenAbove
from armcell.tasks.clearing.steps import HELD, StillThere, empty_handed, holds
from armcell.tasks.context import StageReport, TaskContext
from armcell.tasks.recipes import planned
from armcell.tasks.search import Stage
from armcell.tasks.stages import Connect, Planned, Straight
from armcell.tasks.steps import Grip, perform_all

Look = Callable[[], CameraImage]
Rectangle = tuple[tuple[float, float], tuple[float, float]]  # lowest and highest corner [m, world x and y]


@dataclass(frozen=True)
class Ground:
    """A level part of the cell that things may lie on."""

    name: str
    rectangle: Rectangle
    floor: float  # [m, world z]
    without: tuple[Rectangle, ...] = ()  # parts of it that something else stands on


@dataclass(frozen=True, eq=False)
class Seen:
    """What one look at a ground found."""

    ground: Ground
    map: HeightMap
    labels: NDArray[np.int64]

    @property
    def count(self) -> int:
        """Of pieces; things that touch may be one piece, and one thing several."""
        return int(self.labels.max()) + 1


@dataclass
class Tally:
    """What has been done so far."""

    picks: int = 0  # grasps that were closed
    put: int = 0  # things that were in the hand until it opened over the tray
    missed: int = 0  # closed on nothing, or lost before the lift's end
    dropped: int = 0  # lost on the way
    unplanned: int = 0  # looks after which no way to any grasp was found
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
    """Take what lies in a bin out of it, piece by piece, and let it go above a tray, until the bin is empty.

    Only pictures and what the hand feels are used. What was dropped is found again in the next picture; what
    fell beside bin or tray is picked up last.

    Args:
        bin, tray: fixed objects with a level floor, square to the world's axes.
        table: the fixed object that both stand on.
        look, look_at_tray: give the newest picture with depth of each.
    Returns:
        SUCCESS when nothing is seen any more; else the reason it was given up. Evidence: `picks`, `put`,
        `missed`, `dropped`, `unplanned` (counts).
    Raises:
        InputError: bin or tray have no level floor, or stand askew.
    """
    warm_up()
    s, tally = settings, Tally()
    bin_ground, tray_ground = _inside(ctx.base, bin, s), _inside(ctx.base, tray, s)
    grounds = (
        (look, bin_ground),
        (look, _beside(ctx.base, bin, table, (bin, tray), s)),
        (look_at_tray, _beside(ctx.base, tray, table, (bin, tray), s)),
    )
    while True:
        if ctx.cancel.is_set():
            return _ended(tally, ErrorCode.PREEMPTED, "cancelled")
        here = _first_not_empty(ctx, grounds, s)
        if isinstance(here, Outcome):
            return _ended(tally, here.code, here.message)
        if tally.in_a_row >= s.most_misses or tally.picks >= s.most_picks:
            last = f"{tally.in_a_row} picks in a row brought nothing"
            if tally.in_a_row < s.most_misses:
                last = f"{tally.picks} picks are all that was allowed"
            where = f"{here.count} {here.ground.name}"
            return _ended(tally, ErrorCode.FAILURE, f"given up, {last}; pieces still seen: {where}")
        _remember_heap(ctx, here)
        grasp, outcome = _pick(ctx, gripper, here, bin, tally, s)
        if grasp is not None and outcome.ok:
            outcome = _put(ctx, gripper, grasp, here.ground, bin, tray_ground, look_at_tray, tally, s)
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


def _ended(tally: Tally, code: ErrorCode, message: str) -> Outcome:
    return Outcome(code, message, tally.as_dict())


def _inside(scene: PlanningScene, name: str, settings: ClearSettings) -> Ground:
    """The floor of a bin or tray, its walls left out.

    Raises:
        InputError: it stands askew.
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
    return Ground(f"in {name}", corner, float(frame.translation[2]))


def _beside(scene: PlanningScene, name: str, table: str, others: tuple[str, ...], s: ClearSettings) -> Ground:
    """The table around a bin or tray, without what stands on it."""
    frame, size_x, size_y = support_surface(scene.object(table))
    half = np.abs(frame.rotation.matrix[:2, :2]) @ np.array([size_x, size_y]) / 2
    (x0, y0), (x1, y1) = _outline(scene.object(name), s.hand_room)
    low = np.maximum(frame.translation[:2] - half, (x0, y0))
    high = np.minimum(frame.translation[:2] + half, (x1, y1))
    corner = ((float(low[0]), float(low[1])), (float(high[0]), float(high[1])))
    without = tuple(_outline(scene.object(n), 2 * s.resolution) for n in others)
    return Ground(f"beside {name}", corner, float(frame.translation[2]), without)


def _outline(item: CollisionObject, room: float) -> Rectangle:
    """The rectangle around an object in the world, and some room."""
    low, high = item.bounds()
    corners = np.array(
        [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    )
    at = item.T_world_object.apply(corners)[:, :2]
    (x0, y0), (x1, y1) = at.min(0) - room, at.max(0) + room
    return (float(x0), float(y0)), (float(x1), float(y1))


# --- looking ---
def _first_not_empty(
    ctx: TaskContext, grounds: Sequence[tuple[Look, Ground]], s: ClearSettings
) -> Seen | Outcome:
    """The first ground on which something is seen; an outcome where nothing is, or there is no picture."""
    for look, ground in grounds:
        seen = _look(ctx, look, ground, s)
        if isinstance(seen, Outcome) or seen.count:
            return seen
    return Outcome(ErrorCode.SUCCESS)


def _look(ctx: TaskContext, look: Look, ground: Ground, s: ClearSettings) -> Seen | Outcome:
    """A ground in a new picture, or why there is none."""
    report = StageReport(f"look {ground.name}", started_s=ctx.driver.now)
    ctx.emit("stage", report.name, phase="begin")
    image = look()
    trouble = unusable(image, s.max_age, ctx.driver.now)
    report.ok, report.error = trouble is None, "" if trouble is None else trouble.message
    ctx.reports.append(report)
    ctx.emit("stage", report.name, phase="end", ok=report.ok)
    if trouble is not None:
        return trouble
    (x0, y0), (x1, y1) = ground.rectangle
    room = s.hand_room
    low, high = (x0 - room, y0 - room), (x1 + room, y1 + room)
    seen = height_map(image, ctx.scene(), low, high, ground.floor, s.resolution)
    inside = seen.cells_within(*ground.rectangle)
    for other in ground.without:
        inside &= ~seen.cells_within(*other)
    return Seen(ground, seen, pieces(seen, inside, ground.floor + s.above_floor))


def _remember_heap(ctx: TaskContext, seen: Seen) -> None:
    """What was seen, as points in the planning scene."""
    points = seen.map.at(np.argwhere(seen.labels >= 0)[::3])
    cloud = CollisionObject.single(HEAP, PointCloud(points, 2 * seen.map.resolution))

    def remembered(scene: PlanningScene) -> PlanningScene:
        scene = scene.without_object(HEAP) if HEAP in scene.objects else scene
        return scene.with_object(cloud)

    ctx.change_scene(remembered)


# --- moving ---
def _pick(
    ctx: TaskContext, gripper: Gripper, here: Seen, bin: str, tally: Tally, s: ClearSettings
) -> tuple[HeapGrasp | None, Outcome]:
    """The best grasp that can be reached, lifted; None where nothing was tried."""
    hand, grasps = hand_of(ctx.base.model, gripper), []
    for how in (s.grasps, _closer(s.grasps, 2), _closer(s.grasps, 3)):
        grasps = grasps_from_above(here.map, here.labels, here.ground.floor, hand, s.force, how, tally.avoid)
        if grasps:
            break
    if not grasps:
        tally.unplanned += 1
        text = f"{here.count} pieces {here.ground.name}, the hand fits around none of them"
        return None, Outcome(ErrorCode.PLANNING_FAILED, text)
    t = ctx.settings
    stages: list[Stage] = [
        ChooseFromHeap(grasps, gripper, t.near, t.approach_distance),
        Connect("move to pre-grasp", gripper.arm_group, t.free, target="pre_grasp"),
        Planned("approach", "after_approach"),
        CloseOnHeap(gripper, here.ground.floor, t.grasp_settle, s.thinnest),
        Straight("lift", gripper.arm_group, gripper.tcp_link, t.near, (0.0, 0.0, s.lift),
                 allow=((HELD, (HEAP, bin)), (HEAP, gripper.hand_links))),
    ]  # fmt: skip
    draft, outcome = planned(ctx, stages, f"pick {here.ground.name}")
    if draft is None:
        tally.unplanned += 1
        return None, outcome
    grasp: HeapGrasp = draft.data["grasp"]
    tally.picks += 1
    outcome = perform_all(ctx, (*draft.steps, StillThere(gripper, s.thinnest)))
    if not outcome.ok and outcome.code is not ErrorCode.PREEMPTED:
        tally.missed += 1
        at, y = grasp.T_object_tcp.translation, grasp.T_object_tcp.rotation.matrix[:, 1]
        tally.avoid.append((float(at[0]), float(at[1]), float(np.arctan2(y[1], y[0]))))
        _give_way(ctx, gripper, grasp.opening, bin, s)
    return grasp, outcome


def _closer(settings: AboveSettings, times: int) -> AboveSettings:
    """For what stands close to a wall: with so many times less room, more turns, and corners too."""
    return replace(
        settings,
        room=settings.room / times,
        turns=times * settings.turns,
        least_touch=settings.least_touch / 2,
    )


def _give_way(ctx: TaskContext, gripper: Gripper, opening: float, bin: str, s: ClearSettings) -> None:
    """Let go and go straight up, as far as it goes; then out of the camera's view.

    The fingers open where they press on something, and no farther than there was room before they closed:
    they may stand elsewhere by now, and what lay beside them too.
    """
    empty_handed(ctx)
    t, reading = ctx.settings, ctx.driver.gripper(gripper.name)
    if holds(reading, s.thinnest):
        width = min(reading.width + t.release_margin, opening)
        Grip("open", gripper, width, gripper.max_force, t.release_settle).perform(ctx)
    touching = ((HEAP, gripper.hand_links), (bin, gripper.hand_links))
    up = Straight("retreat", gripper.arm_group, gripper.tcp_link, t.near, (0.0, 0.0, s.lift), allow=touching)
    draft, _ = planned(ctx, [up], "retreat")
    if draft is not None:
        perform_all(ctx, draft.steps)
    _out_of_view(ctx, gripper)


def _out_of_view(ctx: TaskContext, gripper: Gripper) -> None:
    """To the first named state of the arm that there is a way to."""
    for name in ctx.base.model.named_states.get(gripper.arm_group, {}):
        stage = Connect(f"move to {name}", gripper.arm_group, ctx.settings.free, goal=NamedGoal(name))
        draft, _ = planned(ctx, [stage], f"move to {name}")
        if draft is not None:
            perform_all(ctx, draft.steps)
            return


def _put(
    ctx: TaskContext, gripper: Gripper, grasp: HeapGrasp, source: Ground, bin: str, tray: Ground, look: Look,
    tally: Tally, s: ClearSettings,
) -> Outcome:  # fmt: skip
    """Let go of what is held where the tray is lowest; FAILURE where it is full."""
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
        ChooseSpot(spots, hang, gripper, t.near, t.lower_distance),
        Connect("move to tray", gripper.arm_group, t.carry, target="pre_place"),
        Planned("lower", "after_lower"),
        OpenAbove(gripper, t.release_margin, t.release_settle, s.thinnest),
        Straight("retreat", gripper.arm_group, gripper.tcp_link, t.near, (0.0, 0.0, t.retreat_distance)),
    ]  # fmt: skip
    draft, outcome = planned(ctx, stages, f"put {tray.name}")
    if draft is not None:
        outcome = perform_all(ctx, draft.steps)
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
    """Down again, the way it was lifted, and open."""
    touching = ((HELD, (HEAP, bin)), (HEAP, gripper.hand_links))
    down = (0.0, 0.0, s.gap - s.lift)
    stage = Straight("lay back", gripper.arm_group, gripper.tcp_link, ctx.settings.near, down, allow=touching)
    draft, _ = planned(ctx, [stage], "lay back")
    if draft is not None:
        perform_all(ctx, draft.steps)
    _give_way(ctx, gripper, grasp.opening, bin, s)


def _lowest(tray: Seen, s: ClearSettings, count: int = 12) -> list[tuple[float, float, float]]:
    """Places of the tray (x, y, the highest point near them), the lowest first, then the farthest from what
    lies there."""
    from scipy.ndimage import distance_transform_edt, maximum_filter

    map, r = tray.map, s.spot_radius
    (x0, y0), (x1, y1) = tray.ground.rectangle
    size = 2 * int(np.ceil(r / map.resolution)) + 1
    inside = map.cells_within(*tray.ground.rectangle)
    heights = np.where(inside, map.heights, tray.ground.floor)
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
