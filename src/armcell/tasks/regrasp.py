"""Where to lay an object down in between, when no single grasp takes it to where it shall be.

A graph: its nodes are poses in which the object rests, and two of them are joined by a grasp with which the
hand can be around the object at both. It is searched breadth first, by where hands fit, what arms reach and
what touches; no motion is planned here (`laying.py` does). After Tournassoud, Lozano-Perez, Mazer, Regrasping
(ICRA 1987), and Wan, Harada, Developing and comparing single-arm and dual-arm regrasp (RA-L 2016).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest

import numpy as np

from armcell.collision import neighbours
from armcell.core import SE3, InputError
from armcell.grasping import RELEASE_GAP, Grasp, Placement, grasp_candidates, hand_of, place_candidates
from armcell.grasping.placing import surface_for
from armcell.model import Gripper
from armcell.scene import PlanningScene
from armcell.tasks.context import Rejections
from armcell.tasks.proof import varied
from armcell.tasks.search import Planning
from armcell.tasks.stages.grasp import finger_state, reachable
from armcell.tasks.stages.moves import shifted, straight
from armcell.tasks.stages.place import NO_SIDE, Vector, hand_in_support, surface_of_place

SIDES = 8  # of an object on which it is laid, the firmest first
SPOTS = 24  # free places looked at for each of them
GOALS = 8  # free places looked at where it shall be
GRASPS = 60  # that differ, in one pose
ENOUGH = 4  # grasps from one pose to another
STEP = 0.10  # [m] between places around where it is


@dataclass(frozen=True, eq=False)
class Spot:
    """A place at which an object rests; `on` is empty where it is now."""

    on: str
    placement: Placement

    @property
    def up(self) -> Vector:
        """What of the object is up there (unit vector in its frame)."""
        x, y, z = self.placement.T_world_object.rotation.matrix.T @ self.placement.normal
        return float(x), float(y), float(z)


@dataclass(frozen=True, eq=False)
class Leg:
    """The object is taken by one of some grasps and put on one of some spots."""

    grasps: tuple[str, ...]  # names; none where it is in the hand
    spots: tuple[Spot, ...]


@dataclass(frozen=True, eq=False)
class Wanted:
    """What shall become of an object: on what, where there, which direction of its frame up."""

    object: str
    on: str
    at: tuple[float, float] | None = None
    up: Vector | None = None


def ways(
    scene: PlanningScene, wanted: Wanted, gripper: Gripper, planning: Planning, most: int
) -> Iterator[tuple[Leg, ...]]:
    """Ways with up to so many lay-downs, those with the fewest first; the last leg ends where it is wanted.

    What is rejected is told to `planning`: a line for each side the object could lie on.
    """
    goals = _goals(scene, wanted, planning)
    sides = _sides(scene, wanted)
    if not goals or planning.hopeless:
        return
    hands = _Hands(scene, wanted.object, gripper, planning)
    onward = {side for side, spots in sides.items() if spots and hands.leads_on(spots[0], goals)}
    seen: set[int] = set()
    if onward:
        yield from _breadth_first(hands, sides, onward, goals, planning, most, seen)
    _tell(planning, hands, sides, onward, seen, _rounded(goals[0].up))


def _breadth_first(
    hands: _Hands, sides: dict[Vector, list[Spot]], onward: set[Vector], goals: tuple[Spot, ...],
    planning: Planning, most: int, seen: set[int],
) -> Iterator[tuple[Leg, ...]]:  # fmt: skip
    """The ways, with the sides from which a grasp leads to a goal first; `seen` gets what can be reached."""
    order = [
        (side, spot)
        for spots in zip_longest(*sides.values())
        for side, spot in zip(sides, spots, strict=True)
        if spot is not None
    ]
    order.sort(key=lambda pair: pair[0] not in onward)
    layer: list[tuple[Spot, tuple[Leg, ...]]] = [(hands.start, ())]
    for left in reversed(range(most)):
        reached: list[tuple[Spot, tuple[Leg, ...]]] = []
        for side, spot in order:
            if id(spot) in seen or (left == 0 and side not in onward):
                continue
            for last, legs in layer:
                if planning.hopeless:
                    return
                names = hands.shared(last, (spot,))
                if names:
                    seen.add(id(spot))
                    way = (*legs, Leg(names, (spot,)))
                    reached.append((spot, way))
                    if side in onward and (names := hands.shared(spot, goals)):
                        yield *way, Leg(names, goals)
                    break
        layer = reached


def _goals(scene: PlanningScene, wanted: Wanted, planning: Planning) -> tuple[Spot, ...]:
    """Free places for the object where it is wanted, best first."""
    item, on = scene.object(wanted.object), wanted.on
    try:
        found = [Spot(on, p) for p in place_candidates(item, scene.object(on), wanted.at, up=wanted.up)]
    except InputError as error:  # it does not fit
        planning.reject("goal", item.name, str(error))
        return ()
    if not found:
        planning.reject("goal", item.name, NO_SIDE)
    goals, in_the_way = [], ""
    for spot in found[: planning.settings.max_candidates]:
        touched = _touched(scene, item.name, spot)
        if not touched:
            goals.append(spot)
        in_the_way = in_the_way or touched
        if len(goals) == GOALS:
            break
    if found and not goals:
        planning.reject("goal", found[0].placement.name, f"{item.name} would touch {in_the_way}")
    return tuple(goals)


def _touched(scene: PlanningScene, item: str, spot: Spot) -> str:
    """What an object would touch at a spot, besides what it rests on; empty where nothing."""
    put = scene.with_detached(item) if item in scene.attached else scene
    put = put.with_object_pose(item, spot.placement.above(RELEASE_GAP))
    return ", ".join(neighbours(put, item, 0.0))


def _sides(scene: PlanningScene, wanted: Wanted) -> dict[Vector, list[Spot]]:
    """Free places to lay the object down, by what is up there, the nearest first."""
    name = wanted.object
    item = scene.object(name)
    now = item.T_world_object.translation
    near = [wanted.on] if name in scene.attached else [*neighbours(scene, name), wanted.on]
    others = [o.name for o in scene.objects.values() if not o.movable and o.name != name]
    found: dict[Vector, list[Spot]] = {}
    for on in dict.fromkeys([*near, *others]):
        for placement in _all_over(scene, name, on, now):
            spot = Spot(on, placement)
            side = _rounded(spot.up)
            if len(found) < SIDES or side in found:
                found.setdefault(side, []).append(spot)
    for side, spots in found.items():
        spots.sort(key=lambda s: float(np.linalg.norm(s.placement.T_world_object.translation - now)))
        free = (spot for spot in spots if not _touched(scene, name, spot))
        found[side] = [spot for spot, _ in zip(free, range(SPOTS), strict=False)]
    return found


def _all_over(scene: PlanningScene, name: str, on: str, now: np.ndarray) -> Iterator[Placement]:
    """Placements on all firm sides, around where an object is now and all over a support."""
    item, support = scene.object(name), scene.object(on)
    try:
        x, y, _ = surface_for(item, support)[0].inv().apply(now)
    except InputError:  # nothing to lay it on
        return
    for at, step in (((float(x), float(y)), STEP), (None, STEP / 2)):
        try:
            yield from place_candidates(item, support, at, step, other_sides=True)
        except InputError:  # not there
            continue


def _rounded(up: Vector) -> Vector:
    x, y, z = (round(v, 2) + 0.0 for v in up)
    return x, y, z


class _Hands:
    """With which grasps a hand can be around an object where it rests: asked once each."""

    def __init__(self, scene: PlanningScene, name: str, gripper: Gripper, planning: Planning):
        self.told: dict[Vector, Rejections] = {}  # why not, by what was up
        self._planning = replace(planning)
        self._gripper, self._name = gripper, name
        held = scene.attached.get(name)
        self.scene = scene.with_detached(name) if held else scene
        self._item = self.scene.object(name)
        T = self._item.T_world_object
        self.start = Spot("", Placement("where it is", T))
        self._hand = hand_of(scene.model, gripper)
        self._grasps: dict[Vector, list[Grasp]] = {}
        self._can: dict[tuple[int, int], bool] = {}
        self._surfaces: dict[tuple[str, Vector], tuple[SE3, float, float]] = {}
        self._as_held: Grasp | None = None
        if held:
            width = gripper.width(scene.state[gripper.joint_name])
            T_object_tcp = T.inv() @ scene.frame_pose(gripper.tcp_link)
            self._as_held = Grasp("as it is held", T_object_tcp, width, width, 0.0)

    def grasps(self, spot: Spot) -> list[Grasp]:
        """Candidates for an object that rests there."""
        if spot is self.start and self._as_held is not None:
            return [self._as_held]
        side = _rounded(spot.up)
        if side not in self._grasps:
            item = replace(self._item, T_world_object=spot.placement.T_world_object)
            found, rejected = grasp_candidates(item, self._hand)
            self._grasps[side] = varied(found, GRASPS)
            for rejection in rejected if not found else ():
                self._tell(side, rejection.name, rejection.reason)
        return self._grasps[side]

    def leads_on(self, spot: Spot, goals: Sequence[Spot]) -> bool:
        """Whether any grasp on that side, wherever it lies, can be around the object at a goal."""
        return any(self.can(grasp, goal) for grasp in self.grasps(spot) for goal in goals)

    def shared(self, here: Spot, there: Sequence[Spot]) -> tuple[str, ...]:
        """Names of some grasps from one place to another."""
        found: list[str] = []
        for grasp in self.grasps(here):
            if self._fits(grasp, here) and any(self.can(grasp, t) for t in there) and self.can(grasp, here):
                found.append(grasp.name)
                if len(found) == ENOUGH:
                    break
        return tuple(found)

    def can(self, grasp: Grasp, spot: Spot) -> bool:
        """Whether the arm reaches it, with the hand off what the object rests on and touching nothing, also
        straight back from there."""
        if grasp is self._as_held and spot is self.start:
            return True
        key = id(grasp), id(spot)
        if key not in self._can:
            self._can[key] = self._fits(grasp, spot) and self._reaches(grasp, spot)
        return self._can[key]

    def _fits(self, grasp: Grasp, spot: Spot) -> bool:
        if not spot.on:  # candidates there have been looked at for that
            return True
        key = spot.on, spot.placement.normal
        if key not in self._surfaces:
            self._surfaces[key] = surface_of_place(self.scene.object(spot.on), spot.placement)
        T_world_tcp = spot.placement.above(RELEASE_GAP) @ grasp.T_object_tcp
        deep = hand_in_support(self._hand, T_world_tcp, self._surfaces[key])
        if deep > 0:
            self._tell(
                _rounded(spot.up), grasp.name, f"the hand would be inside {spot.on}: {deep * 1000:.0f} mm"
            )
        return deep <= 0

    def _reaches(self, grasp: Grasp, spot: Spot) -> bool:
        if self._planning.hopeless:
            return False
        T = spot.placement.T_world_object if not spot.on else spot.placement.above(RELEASE_GAP)
        scene = self.scene.with_object_pose(self._name, T).with_allowed(self._name, self._gripper.hand_links)
        scene = scene.with_state(finger_state(self._gripper, grasp.opening))
        look = replace(self._planning, rejections=Rejections())
        s, gripper, T_world_tcp = look.settings, self._gripper, T @ grasp.T_object_tcp
        back = shifted(T_world_tcp, (0.0, 0.0, -(s.retreat_distance if spot.on else s.least_approach)), True)
        for arm in reachable(scene, gripper, T_world_tcp, look, "reach", grasp.name):
            result = straight(scene.with_state(arm), gripper.arm_group, gripper.tcp_link, back, s.near)
            if result.ok:
                return True
            look.reject("retreat", grasp.name, f"no way back: {result.message}")
        for _, candidate, reason in look.rejections.details:
            self._tell(_rounded(spot.up), candidate, reason)
        return False

    def _tell(self, side: Vector, candidate: str, reason: str) -> None:
        self.told.setdefault(side, Rejections()).add("", candidate, reason)

    def why(self, side: Vector, most: int = 2) -> str:
        """The commonest reasons with that side up, counted, and the first in full."""
        if side not in self.told:
            return ""
        told = self.told[side]
        order = sorted(told.counts.items(), key=lambda kv: -kv[1])[:most]
        _, candidate, reason = told.details[0]
        return ", ".join(f"{n} x {short}" for (_, short), n in order) + f"; {candidate!r}: {reason}"


def _tell(
    planning: Planning, hands: _Hands, sides: dict[Vector, list[Spot]], onward: set[Vector], seen: set[int],
    goal: Vector,
) -> None:  # fmt: skip
    """Why there are no more ways, side by side; a side from which one leads on comes first."""
    if not sides:
        planning.reject("lay down", "", "there is no free place")
    for side, spots in sorted(sides.items(), key=lambda pair: pair[0] not in onward):
        if not spots:
            text = "no free place"
        elif side not in onward:
            text = "no grasp leads on from there"
        elif not any(id(spot) in seen for spot in spots):
            text = "no grasp leads there"
        else:
            text = "no grasp leads both there and on"
        where = side if side in onward else goal
        why = hands.why(where) if spots else ""
        planning.reject("lay down", f"{side} up", f"{text}: {why}" if why else text)
