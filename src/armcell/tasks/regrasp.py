"""Regrasp planning: search for intermediate placements if no single grasp suffices.

The nodes of the graph are resting poses of the object; a grasp that is feasible at both poses connects two
nodes. The search is breadth-first with cheap tests: hand clearance, reachability, contacts. It plans no
motion (`intermediate_placement.py` does). Sources: Tournassoud, Lozano-Perez, Mazer, Regrasping (ICRA 1987);
Wan, Harada, Developing and comparing single-arm and dual-arm regrasp (RA-L 2016).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest

import numpy as np

from armcell.collision import neighbors
from armcell.core import SE3, InputError
from armcell.grasping import RELEASE_GAP, Grasp, Placement, grasp_candidates, hand_of, place_candidates
from armcell.grasping.placements import surface_for
from armcell.model import Gripper
from armcell.scene import PlanningScene
from armcell.tasks.context import Rejections
from armcell.tasks.grasp_proof import distinct_grasps
from armcell.tasks.search import SearchState
from armcell.tasks.stages.grasp import finger_state, reachable
from armcell.tasks.stages.moves import plan_straight, shifted
from armcell.tasks.stages.place import NO_SIDE, Vector, hand_in_support, surface_of_place

SIDES = 8  # stable sides of an object, most stable first
POSES = 24  # free resting poses per side
GOALS = 8  # free goal poses
GRASPS = 60  # distinct grasps per pose
ENOUGH = 4  # grasps between two poses
STEP = 0.10  # [m] grid around the present position


@dataclass(frozen=True, eq=False)
class RestingPose:
    """Resting pose of an object on a support, used for regrasping. `on` is the name of the support, or empty
    if this is the object's present pose.
    """

    on: str
    placement: Placement

    @property
    def up(self) -> Vector:
        """Return the direction that points upward at a resting pose for
        regrasping (unit vector in the object's frame).
        """
        x, y, z = self.placement.T_world_object.rotation.matrix.T @ self.placement.normal
        return float(x), float(y), float(z)


@dataclass(frozen=True, eq=False)
class RegraspStep:
    """Step of a regrasp: pick the object with one of several grasps, and place it at one of several poses."""

    grasps: tuple[str, ...]  # names; empty if the hand already holds the object
    poses: tuple[RestingPose, ...]


@dataclass(frozen=True, eq=False)
class PlacementGoal:
    """Goal for an object that is regrasped: its support, a point on the support,
    and the direction that must point upward.
    """

    object: str
    on: str
    at: tuple[float, float] | None = None
    up: Vector | None = None


def regrasp_sequences(
    scene: PlanningScene, goal: PlacementGoal, gripper: Gripper, planning: SearchState, most: int
) -> Iterator[tuple[RegraspStep, ...]]:
    """Yield regrasp sequences that bring an object to its goal, shortest first.

    A sequence has at most `most` intermediate placements.

    Reports one rejection per side of the object to `planning`.
    """
    goals = _goals(scene, goal, planning)
    sides = _sides(scene, goal)
    if not goals or planning.should_stop:
        return
    hands = _Hands(scene, goal.object, gripper, planning)
    onward = {side for side, poses in sides.items() if poses and hands.leads_on(poses[0], goals)}
    seen: set[int] = set()
    if onward:
        yield from _breadth_first(hands, sides, onward, goals, planning, most, seen)
    _report(planning, hands, sides, onward, seen, _rounded(goals[0].up))


def _breadth_first(
    hands: _Hands, sides: dict[Vector, list[RestingPose]], onward: set[Vector],
    goals: tuple[RestingPose, ...], planning: SearchState, most: int, seen: set[int],
) -> Iterator[tuple[RegraspStep, ...]]:  # fmt: skip
    """Yield regrasp sequences, found by a breadth-first search over the resting poses of an object. The
    search first tries the orientations from which the object can be moved directly to the goal.

    Adds the ids of reachable poses to `seen`.
    """
    order = [
        (side, pose)
        for poses in zip_longest(*sides.values())
        for side, pose in zip(sides, poses, strict=True)
        if pose is not None
    ]
    order.sort(key=lambda pair: pair[0] not in onward)
    layer: list[tuple[RestingPose, tuple[RegraspStep, ...]]] = [(hands.start, ())]
    for left in reversed(range(most)):
        reached: list[tuple[RestingPose, tuple[RegraspStep, ...]]] = []
        for side, pose in order:
            if id(pose) in seen or (left == 0 and side not in onward):
                continue
            for last, steps in layer:
                if planning.should_stop:
                    return
                names = hands.shared(last, (pose,))
                if names:
                    seen.add(id(pose))
                    sequence = (*steps, RegraspStep(names, (pose,)))
                    reached.append((pose, sequence))
                    if side in onward and (names := hands.shared(pose, goals)):
                        yield *sequence, RegraspStep(names, goals)
                    break
        layer = reached


def _goals(scene: PlanningScene, goal: PlacementGoal, planning: SearchState) -> tuple[RestingPose, ...]:
    """Return the collision-free goal poses of an object that is regrasped, best first."""
    item, on = scene.object(goal.object), goal.on
    try:
        found = [RestingPose(on, p) for p in place_candidates(item, scene.object(on), goal.at, up=goal.up)]
    except InputError as error:  # the object does not fit
        planning.reject("goal", item.name, str(error))
        return ()
    if not found:
        planning.reject("goal", item.name, NO_SIDE)
    goals, in_the_way = [], ""
    for pose in found[: planning.settings.max_candidates]:
        touched = _touched(scene, item.name, pose)
        if not touched:
            goals.append(pose)
        in_the_way = in_the_way or touched
        if len(goals) == GOALS:
            break
    if found and not goals:
        planning.reject("goal", found[0].placement.name, f"{item.name} would touch {in_the_way}")
    return tuple(goals)


def _touched(scene: PlanningScene, item: str, pose: RestingPose) -> str:
    """Name the objects, apart from the support, that a regrasped object would touch at a resting pose."""
    put = scene.with_detached(item) if item in scene.attached else scene
    put = put.with_object_pose(item, pose.placement.above(RELEASE_GAP))
    return ", ".join(neighbors(put, item, 0.0))


def _sides(scene: PlanningScene, goal: PlacementGoal) -> dict[Vector, list[RestingPose]]:
    """Return the collision-free resting poses for regrasping an object, grouped by upward direction in the
    object's frame. Each group is sorted by distance from the object's present position.
    """
    name = goal.object
    item = scene.object(name)
    now = item.T_world_object.translation
    near = [goal.on] if name in scene.attached else [*neighbors(scene, name), goal.on]
    others = [o.name for o in scene.objects.values() if not o.movable and o.name != name]
    found: dict[Vector, list[RestingPose]] = {}
    for on in dict.fromkeys([*near, *others]):
        for placement in _all_over(scene, name, on, now):
            pose = RestingPose(on, placement)
            side = _rounded(pose.up)
            if len(found) < SIDES or side in found:
                found.setdefault(side, []).append(pose)
    for side, poses in found.items():
        poses.sort(key=lambda s: float(np.linalg.norm(s.placement.T_world_object.translation - now)))
        free = (pose for pose in poses if not _touched(scene, name, pose))
        found[side] = [pose for pose, _ in zip(free, range(POSES), strict=False)]
    return found


def _all_over(scene: PlanningScene, name: str, on: str, now: np.ndarray) -> Iterator[Placement]:
    """Yield intermediate placements for regrasping, with each stable side of the object facing down.
    Placements near the object come first, then placements on the whole support.
    """
    item, support = scene.object(name), scene.object(on)
    try:
        x, y, _ = surface_for(item, support)[0].inverse().apply(now)
    except InputError:  # no surface
        return
    for at, step in (((float(x), float(y)), STEP), (None, STEP / 2)):
        try:
            yield from place_candidates(item, support, at, step, other_sides=True)
        except InputError:  # no placement there
            continue


def _rounded(up: Vector) -> Vector:
    x, y, z = (round(v, 2) + 0.0 for v in up)
    return x, y, z


class _Hands:
    """Cache for regrasp planning that stores which grasps are feasible at each resting pose of an object."""

    def __init__(self, scene: PlanningScene, name: str, gripper: Gripper, planning: SearchState):
        self.rejections: dict[Vector, Rejections] = {}  # rejections by the upward direction
        self._planning = replace(planning)
        self._gripper, self._name = gripper, name
        held = scene.attached.get(name)
        self.scene = scene.with_detached(name) if held else scene
        self._item = self.scene.object(name)
        T = self._item.T_world_object
        self.start = RestingPose("", Placement("where it is", T))
        self._hand = hand_of(scene.model, gripper)
        self._grasps: dict[Vector, list[Grasp]] = {}
        self._can: dict[tuple[int, int], bool] = {}
        self._surfaces: dict[tuple[str, Vector], tuple[SE3, float, float]] = {}
        self._as_held: Grasp | None = None
        if held:
            width = gripper.width_in(scene.state)
            T_object_tcp = T.inverse() @ scene.frame_pose(gripper.tcp_link)
            self._as_held = Grasp("current grasp", T_object_tcp, width, width, 0.0)

    def grasps(self, pose: RestingPose) -> list[Grasp]:
        """Return the candidate grasps for regrasping an object that rests at a given pose."""
        if pose is self.start and self._as_held is not None:
            return [self._as_held]
        side = _rounded(pose.up)
        if side not in self._grasps:
            item = replace(self._item, T_world_object=pose.placement.T_world_object)
            found, rejected = grasp_candidates(
                item, self._hand, pose_error=self._planning.settings.pose_error
            )
            self._grasps[side] = distinct_grasps(found, GRASPS)
            for rejection in rejected if not found else ():
                self._report(side, rejection.name, rejection.reason)
        return self._grasps[side]

    def leads_on(self, pose: RestingPose, goals: Sequence[RestingPose]) -> bool:
        """Return whether one grasp of the object is feasible both at a
        resting pose and at a goal pose of the regrasp.
        """
        return any(self.can(grasp, goal) for grasp in self.grasps(pose) for goal in goals)

    def shared(self, here: RestingPose, there: Sequence[RestingPose]) -> tuple[str, ...]:
        """Return the names of grasps that are feasible both at the resting pose `here` and at one or more
        resting poses in `there`. A regrasp sequence can use them to move the object.
        """
        found: list[str] = []
        for grasp in self.grasps(here):
            if self._fits(grasp, here) and any(self.can(grasp, t) for t in there) and self.can(grasp, here):
                found.append(grasp.name)
                if len(found) == ENOUGH:
                    break
        return tuple(found)

    def can(self, grasp: Grasp, pose: RestingPose) -> bool:
        """Return whether the arm can grasp the object without collision at a resting pose of a regrasp
        sequence.

        A straight retreat must be possible as well.
        """
        if grasp is self._as_held and pose is self.start:
            return True
        key = id(grasp), id(pose)
        if key not in self._can:
            self._can[key] = self._fits(grasp, pose) and self._reaches(grasp, pose)
        return self._can[key]

    def _fits(self, grasp: Grasp, pose: RestingPose) -> bool:
        if not pose.on:  # the grasp generator has checked the present pose
            return True
        key = pose.on, pose.placement.normal
        if key not in self._surfaces:
            self._surfaces[key] = surface_of_place(self.scene.object(pose.on), pose.placement)
        T_world_tcp = pose.placement.above(RELEASE_GAP) @ grasp.T_object_tcp
        deep = hand_in_support(self._hand, T_world_tcp, self._surfaces[key])
        if deep > 0:
            self._report(
                _rounded(pose.up), grasp.name, f"the hand would be inside {pose.on}: {deep * 1000:.0f} mm"
            )
        return deep <= 0

    def _reaches(self, grasp: Grasp, pose: RestingPose) -> bool:
        if self._planning.should_stop:
            return False
        T = pose.placement.T_world_object if not pose.on else pose.placement.above(RELEASE_GAP)
        scene = self.scene.with_object_pose(self._name, T).with_allowed(self._name, self._gripper.hand_links)
        scene = scene.with_state(finger_state(self._gripper, grasp.opening))
        look = replace(self._planning, rejections=Rejections())
        s, gripper, T_world_tcp = look.settings, self._gripper, T @ grasp.T_object_tcp
        back = shifted(T_world_tcp, (0.0, 0.0, -(s.retreat_distance if pose.on else s.least_approach)), True)
        for arm in reachable(scene, gripper, T_world_tcp, look, "reach", grasp.name):
            result = plan_straight(scene.with_state(arm), gripper.arm_group, gripper.tcp_link, back, s.near)
            if result.ok:
                return True
            look.reject("retreat", grasp.name, f"no straight retreat: {result.message}")
        for _, candidate, reason in look.rejections.details:
            self._report(_rounded(pose.up), candidate, reason)
        return False

    def _report(self, side: Vector, candidate: str, reason: str) -> None:
        self.rejections.setdefault(side, Rejections()).add("", candidate, reason)

    def why(self, side: Vector, most: int = 2) -> str:
        """Return why the regrasp planner rejected grasps of an object that rests on a given side: the most
        frequent reasons, with their counts.

        Also returns the first reason in full.
        """
        if side not in self.rejections:
            return ""
        rejections = self.rejections[side]
        order = sorted(rejections.counts.items(), key=lambda kv: -kv[1])[:most]
        _, candidate, reason = rejections.details[0]
        return ", ".join(f"{n} x {short}" for (_, short), n in order) + f"; {candidate!r}: {reason}"


def _report(
    planning: SearchState, hands: _Hands, sides: dict[Vector, list[RestingPose]], onward: set[Vector],
    seen: set[int], goal: Vector,
) -> None:  # fmt: skip
    """Report why no regrasp sequence was found, separately for each side on which the object can rest.

    Sides with a grasp to the goal come first.
    """
    if not sides:
        planning.reject("intermediate placement", "", "there is no free resting pose")
    for side, poses in sorted(sides.items(), key=lambda pair: pair[0] not in onward):
        if not poses:
            text = "no free resting pose"
        elif side not in onward:
            text = "no grasp there also reaches the goal"
        elif not any(id(pose) in seen for pose in poses):
            text = "no grasp also reaches the present pose"
        else:
            text = "no sequence of grasps connects it"
        where = side if side in onward else goal
        why = hands.why(where) if poses else ""
        planning.reject("intermediate placement", f"{side} up", f"{text}: {why}" if why else text)
