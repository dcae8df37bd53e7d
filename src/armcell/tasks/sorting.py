"""Sorting of objects that a camera sees, into targets for their color or shape."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from armcell.core import ErrorCode, InputError, Outcome, UnknownNameError
from armcell.core.checks import checked, require
from armcell.grasping import support_surface
from armcell.model import Gripper
from armcell.perception import DetectedObject, DetectionResult, color_name
from armcell.scene import PlanningScene
from armcell.tasks.context import TaskContext
from armcell.tasks.pick import back_off, pick
from armcell.tasks.recipes import move_to, place, release

Kind = Callable[[DetectedObject], str]
"""Sorting criterion: maps a seen object to its kind."""

KINDS: Mapping[str, Kind] = {
    "color": lambda thing: color_name(thing.color),
    "shape": lambda thing: thing.kind,
}
"""`color`: red, orange, yellow, green, cyan, blue, purple, black, grey, white. `shape`: box, cylinder,
sphere, mesh, compound."""
GRID = 0.02  # [m] grid spacing of candidate points on a target
SPOTS = 4  # maximum number of candidate points tried


@dataclass(frozen=True)
@checked()
class SortSettings:
    """Settings for sorting objects: limits, and the state in which the arm rests."""

    tries: int = 3  # picks of one object
    most_picks: int = 60
    rest: str = "home"  # named state of the arm outside the camera's view; empty: stay

    def __post_init__(self) -> None:
        for name in ("tries", "most_picks"):
            require(getattr(self, name) >= 1, f"{name} is {getattr(self, name)}, it must be at least 1")


@dataclass
class _Tally:
    """Results of a sorting task so far: objects in their targets, failures and the number of picks."""

    sorted: dict[str, list[str]] = field(default_factory=dict)  # target -> objects, by the last image
    other: dict[str, str] = field(default_factory=dict)  # object -> kind without a target
    failures: dict[str, list[str]] = field(default_factory=dict)  # object -> reasons
    picks: int = 0


def sort(
    ctx: TaskContext,
    gripper: Gripper,
    look: Callable[[], DetectionResult],
    into: Mapping[str, str],
    by: str | Kind = "color",
    settings: SortSettings = SortSettings(),
) -> Outcome:
    """Sort visible objects by kind onto their targets,
    until an image shows that all of them are on their targets.

    The camera takes a new image after each object, so objects that slipped or were moved are found again.

    Args:
        look: takes an image with the arm at rest; must update the planning scene (as `LiveCell.look` does).
        into: target object by kind; objects of other kinds stay where they are.
        by: "color", "shape", or a function of the seen object.
    Returns:
        SUCCESS when all objects of these kinds are in their targets. Evidence: `sorted` (object names by
        target), `other` (kinds without a target), `failures` (reasons by object), `picks`.
    Raises:
        UnknownNameError: no such target, or no such sorting criterion.
    """
    kind = by if callable(by) else _kind(by)
    _check(ctx.scene(), into)
    tally = _Tally()
    while True:
        seen = _look(ctx, gripper, look, settings)
        if not isinstance(seen, DetectionResult):
            return seen
        todo = _todo(ctx.scene(), seen, kind, into, tally)
        open_ = [(t, place) for t, place in todo if len(tally.failures.get(t.name, ())) < settings.tries]
        if not open_ or tally.picks >= settings.most_picks:
            return _ended(tally, todo, seen, settings)
        thing, place_on = open_[0]
        ctx.emit("note", f"{thing.name} is {kind(thing)}: to {place_on}")
        tally.picks += 1
        outcome = _carry(ctx, gripper, thing.name, place_on)
        if outcome.code is ErrorCode.PREEMPTED:
            return outcome
        if not outcome.ok:
            tally.failures.setdefault(thing.name, []).append(outcome.message)


def _kind(name: str) -> Kind:
    if name not in KINDS:
        raise UnknownNameError("property to sort by", name, KINDS)
    return KINDS[name]


def _check(scene: PlanningScene, into: Mapping[str, str]) -> None:
    require(bool(into), "no destinations are given")
    for place_on in into.values():
        support_surface(scene.object(place_on))


def _look(
    ctx: TaskContext, gripper: Gripper, look: Callable[[], DetectionResult], s: SortSettings
) -> DetectionResult | Outcome:
    """Move the arm out of the image, and return the camera's view of the objects to sort."""
    if s.rest:
        moved = move_to(ctx, gripper.arm_group, s.rest)
        if not moved.ok:
            return moved
    ctx.advance(0.1)  # wait for an image of the resting arm
    sight = look()
    if sight.plane is None:
        return Outcome(sight.code, sight.message, sight.evidence)
    return sight


def _todo(
    scene: PlanningScene, seen: DetectionResult, kind: Kind, into: Mapping[str, str], tally: _Tally
) -> list[tuple[DetectedObject, str]]:
    """Return the objects that are still to be sorted, each with its target."""
    tally.sorted, tally.other, todo = {place_on: [] for place_on in into.values()}, {}, []
    for thing in seen.objects:
        what = kind(thing)
        if what not in into:
            tally.other[thing.name] = what
        elif _lies_on(scene, thing, into[what]):
            tally.sorted[into[what]].append(thing.name)
        elif thing.name in scene.objects:
            todo.append((thing, into[what]))
        else:  # seen, but not an object of the cell
            tally.other[thing.name] = f"{what}, of no known shape"
    return todo


def _lies_on(scene: PlanningScene, thing: DetectedObject, place_on: str) -> bool:
    """Return whether an object to be sorted already lies on its target: its detected center is above the
    target's support surface.
    """
    frame, size_x, size_y = support_surface(scene.object(place_on))
    middle = thing.points.mean(axis=0) if thing.T_world_object is None else thing.T_world_object.translation
    x, y, z = frame.inverse().apply(middle)
    return bool(abs(x) < size_x / 2 and abs(y) < size_y / 2 and z > -0.005)


def _carry(ctx: TaskContext, gripper: Gripper, item: str, place_on: str) -> Outcome:
    """Sort one object: pick it and place it on its target.
    If placing fails, put it down where it can be picked again.
    """
    outcome = pick(ctx, item, gripper)
    if not outcome.ok:
        return outcome
    for spot in _spots(ctx.scene(), item, place_on):
        try:
            outcome = place(ctx, item, place_on, at=spot)
        except InputError as error:  # it does not fit in its present orientation
            outcome = Outcome(ErrorCode.PLANNING_FAILED, str(error))
        if outcome.code is not ErrorCode.PLANNING_FAILED:
            break
    if not outcome.ok and outcome.code is not ErrorCode.PREEMPTED:
        if item in ctx.holding:
            release(ctx, gripper)
        back_off(ctx, item, gripper)
    return outcome


def _spots(scene: PlanningScene, item: str, place_on: str) -> list[tuple[float, float]]:
    """Return candidate points for an object on the surface of a sorting target,
    those with the largest free margin first.

    On an empty target the first point is a corner, which leaves space for other objects.

    Returns:
        Points (x, y) [m] from the surface's center.
    """
    frame, size_x, size_y = support_surface(scene.object(place_on))
    low, high = scene.object(item).bounds()
    half = float(np.linalg.norm(high - low)) / 2  # for any orientation
    x, y = (np.arange(-r, r + 1e-9, GRID) for r in (max(size_x / 2 - half, 0), max(size_y / 2 - half, 0)))
    spots = np.array([(a, b) for a in x for b in y])
    near = [
        frame.inverse().apply(other.T_world_object.translation)[:2]
        for name, other in scene.objects.items()
        if other.movable and name != item
    ]
    room = np.full(len(spots), 0.3)  # [m] larger margins count as equal
    for middle in near:
        room = np.minimum(room, np.linalg.norm(spots - middle, axis=1))
    found: list[tuple[float, float]] = []
    for k in np.argsort(-room, kind="stable"):
        if all(np.linalg.norm(spots[k] - other) > half for other in found):
            found.append((float(spots[k][0]), float(spots[k][1])))
    return found[:SPOTS]


def _ended(
    tally: _Tally, todo: list[tuple[DetectedObject, str]], seen: DetectionResult, settings: SortSettings
) -> Outcome:
    evidence = {
        "sorted": tally.sorted, "other": tally.other, "failures": tally.failures, "picks": tally.picks,
    }  # fmt: skip
    strangers = [n for names in tally.sorted.values() for n in names if not seen[n].known]
    missing = seen.missing[len(strangers) :]  # in its target, but recognized as another object
    if not todo and not missing:
        return Outcome(ErrorCode.SUCCESS, "", evidence)
    reasons = [
        f"{thing.name} is not on {place_on}: {(tally.failures.get(thing.name) or ['not tried'])[-1]}"
        for thing, place_on in todo
    ]
    if missing:
        reasons.append(f"{', '.join(missing)} not seen any more")
    if tally.picks >= settings.most_picks:
        reasons.insert(0, f"given up after {tally.picks} picks")
    return Outcome(ErrorCode.FAILURE, "; ".join(reasons), evidence)
