"""Laying an object down in between, where no single grasp takes it to where it shall be."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice, pairwise

from armcell.core import Outcome
from armcell.core.checks import checked, require
from armcell.model import Gripper
from armcell.scene import PlanningScene
from armcell.tasks.context import TaskContext
from armcell.tasks.recipes import pick_stages, place_stages, planned
from armcell.tasks.regrasp import Leg, Spot, Vector, Wanted, ways
from armcell.tasks.search import Draft, Foresee, Planning, Stage, solutions
from armcell.tasks.settings import TaskSettings
from armcell.tasks.stages import ChoosePlacement
from armcell.tasks.steps import perform_all

MOST = 2  # lay-downs in a row


@dataclass(frozen=True)
class LaidDown:
    """One lay-down of a draft: where, and how many of the draft's steps have then been done."""

    spot: Spot
    steps: int


@dataclass(frozen=True, eq=False)
@checked()
class LayDown:
    """Pick an object, or take it as it is held, and lay it down so that another grasp takes it on to a goal,
    up to `most` times. Then it is free to be picked; that from there all the way to the goal can be done is
    planned too, and not kept."""

    object: str
    support: str  # the goal's
    gripper: Gripper
    at: tuple[float, float] | None = None
    up: Vector | None = None
    most: int = MOST
    name: str = "lay down"
    gives = ("laid_down",)

    def __post_init__(self) -> None:
        require(self.most >= 1, f"most is {self.most}, it must be at least 1")

    @property
    def wanted(self) -> Wanted:
        return Wanted(self.object, self.support, self.at, self.up)

    def drafts(self, draft: Draft, planning: Planning) -> Iterator[Draft]:
        inner = replace(planning)  # one motion that fails is not the reason for all
        for way in ways(draft.scene, self.wanted, self.gripper, inner, self.most):
            stages = self._stages(draft.scene, way, planning.settings)
            yield from islice(solutions(stages, draft, inner), 1)
            if planning.hopeless:
                return

    def _stages(self, scene: PlanningScene, way: tuple[Leg, ...], s: TaskSettings) -> list[Stage]:
        stages: list[Stage] = []
        for leg, after in pairwise(way):
            (spot,) = leg.spots
            if self.object not in scene.attached:
                stages += self._picked(scene, leg, s)
            stages += self._put(leg, s)
            stages.append(_Note(spot))
            scene = scene.with_detached(self.object) if self.object in scene.attached else scene
            scene = scene.with_object_pose(self.object, spot.placement.T_world_object)
            if after is way[-1]:
                goes_on = (*self._picked(scene, after, s), *self._put(after, s))
                stages.append(Foresee("on to the goal", goes_on))
        return stages

    def _picked(self, scene: PlanningScene, leg: Leg, s: TaskSettings) -> list[Stage]:
        places = tuple(spot.placement for spot in leg.spots)
        ahead = ChoosePlacement(
            self.object, leg.spots[0].on, self.gripper, s.near, s.lower_distance, among=places
        )
        return pick_stages(scene, self.object, self.gripper, s, ahead=[ahead], among=leg.grasps)

    def _put(self, leg: Leg, s: TaskSettings) -> list[Stage]:
        places = tuple(spot.placement for spot in leg.spots)
        return place_stages(self.object, leg.spots[0].on, self.gripper, s, among=places)


@dataclass(frozen=True, eq=False)
@checked()
class PickAndPlace:
    """Pick an object and place it, with one grasp, or with lay-downs in between where no grasp does it."""

    object: str
    support: str
    gripper: Gripper
    at: tuple[float, float] | None = None
    up: Vector | None = None
    lay_downs: int = MOST
    name: str = "pick and place"
    gives = ("placement",)

    def drafts(self, draft: Draft, planning: Planning) -> Iterator[Draft]:
        found = False
        for straight in self._straight(draft, planning):
            found = True
            yield straight
        if found or planning.hopeless or not self.lay_downs:
            return
        down = LayDown(self.object, self.support, self.gripper, self.at, self.up, self.lay_downs)
        for laid in down.drafts(draft, planning):
            yield from self._straight(laid, planning)

    def _straight(self, draft: Draft, planning: Planning) -> Iterator[Draft]:
        s, item = planning.settings, self.object
        goal = ChoosePlacement(item, self.support, self.gripper, s.near, s.lower_distance, self.at, self.up)
        stages = pick_stages(draft.scene, item, self.gripper, s, ahead=[goal])
        stages += place_stages(item, self.support, self.gripper, s, self.at, self.up)
        yield from solutions(stages, draft, replace(planning))


@dataclass(frozen=True, eq=False)
class _Note:
    """Keeps in the draft what has been laid down where."""

    spot: Spot
    name: str = "laid down"

    def drafts(self, draft: Draft, planning: Planning) -> Iterator[Draft]:
        before = draft.data.get("laid_down", ())
        yield draft.then(laid_down=(*before, LaidDown(self.spot, len(draft.steps))))


def lay_down(
    ctx: TaskContext, item: str, gripper: Gripper, on: str, at: tuple[float, float] | None = None,
    up: Vector | None = None, most: int = MOST,
) -> Outcome:  # fmt: skip
    """Lay an object down from where another grasp, or another lay-down, leads on to a goal; only once.

    All of the way to the goal has been planned before the arm moves. Where the object then really lies is to
    be looked at before it is picked again.

    Args:
        on, at, up: the goal, as for `place`.
        most: lay-downs in a row.
    Returns:
        SUCCESS with `placement`, `laid_on` and `lay_downs` (how many the way has) in the evidence; else the
        reasons by side.
    """
    stages = [LayDown(item, on, gripper, at, up, most)]
    draft, outcome = planned(ctx, stages, f"lay {item} down in between")
    if draft is None:
        return outcome
    laid: tuple[LaidDown, ...] = draft.data["laid_down"]
    first = laid[0]
    count = f", the first time of {len(laid)}" if len(laid) > 1 else ""
    ctx.emit("note", f"{item}: no single grasp; laid down on {first.spot.on} in between{count}")
    outcome = perform_all(ctx, draft.steps[: first.steps])
    told = {"placement": first.spot.placement, "laid_on": first.spot.on, "lay_downs": len(laid)}
    return replace(outcome, evidence={**outcome.evidence, **told})
