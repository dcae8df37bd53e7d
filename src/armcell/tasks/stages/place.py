"""Stages of placing: choose a placement with its straight way down, open."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from armcell.core import SE3, PlanResult
from armcell.grasping import RELEASE_GAP, Grasp, Hand, Placement, hand_of, place_candidates, support_surface
from armcell.model import Gripper
from armcell.scene import CollisionObject, PlanningScene
from armcell.tasks.interfaces import holding
from armcell.tasks.search import Draft, Planning
from armcell.tasks.settings import Speed
from armcell.tasks.stages.grasp import finger_state, reachable
from armcell.tasks.stages.moves import straight
from armcell.tasks.steps import Expect, Grip, Motion, Release, Step, StillHeld, Watch
from armcell.timing import reversed_in_time

UP = (0.0, 0.0, 1.0)
IK_OFF = 1e-4  # [m] that an arm may hold it otherwise than the grasp says
NO_SIDE = "it does not stand with that side up"
DESCENT = ("candidate", "pre_place", "lower", "after_lower")
"""What `ways_down` gives to later stages."""

Vector = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class ChoosePlacement:
    """Place candidates on a support that the arm reaches by a free straight line from above: along the
    surface's normal, or straight down where that is not possible."""

    object: str
    support: str
    gripper: Gripper
    speed: Speed
    distance: float  # [m] of the way down
    at: tuple[float, float] | None = None
    up: Vector | None = None  # direction in the object's frame that shall be up; as it stands where None
    among: tuple[Placement, ...] = ()  # the only placements to be used; all that there are where empty
    name: str = "placement"
    gives = (*DESCENT, "placement")

    @property
    def needs(self) -> tuple[str, ...]:
        return (holding(self.object),)

    def drafts(self, draft: Draft, planning: Planning) -> Iterator[Draft]:
        scene = draft.scene
        candidates = self._candidates(scene)
        if not candidates:
            planning.reject(self.name, self.object, NO_SIDE)
        for placement in candidates[: planning.settings.max_candidates]:
            yield from self._ways_down(draft, planning, placement)

    def _candidates(self, scene: PlanningScene) -> Sequence[Placement]:
        item, support = scene.object(self.object), scene.object(self.support)
        return self.among or place_candidates(item, support, self.at, up=self.up)

    def why_not(self, scene: PlanningScene, most: int) -> Callable[[Grasp], str]:
        """What says of a grasp that with it the hand would be inside the support at the first `most` places.

        Args:
            scene: with the object before it is grasped, turned as it will be.
        """
        hand, places = hand_of(scene.model, self.gripper), self._candidates(scene)[:most]
        surfaces = [surface_of_place(scene.object(self.support), place) for place in places]

        def ask(grasp: Grasp) -> str:
            least = np.inf
            for place, surface in zip(places, surfaces, strict=True):
                T_world_tcp = place.above(RELEASE_GAP) @ grasp.T_object_tcp
                least = min(least, hand_in_support(hand, T_world_tcp, surface))
                if least <= IK_OFF:
                    return ""
            return f"the hand would be inside {self.support}: {least * 1000:.0f} mm" if places else NO_SIDE

        return ask

    def _ways_down(self, draft: Draft, planning: Planning, placement: Placement) -> Iterator[Draft]:
        gripper = self.gripper
        T_tcp_object = draft.scene.frame_pose(gripper.tcp_link).inv() @ draft.scene.frame_pose(self.object)
        T_world_tcp = placement.above(RELEASE_GAP) @ T_tcp_object.inv()
        surface = surface_of_place(draft.scene.object(self.support), placement)
        deep = hand_in_support(hand_of(draft.scene.model, gripper), T_world_tcp, surface)
        if deep > 0:  # said before any arm is asked
            text = f"the hand would be inside {self.support}: {deep * 1000:.0f} mm"
            planning.reject(self.name, placement.name, text)
            return
        scene = draft.scene.with_allowed(self.object, self.support)

        def up(at_place: PlanningScene) -> PlanResult:
            result = off(at_place, placement.normal)
            return result if result.ok or placement.normal == UP else off(at_place, UP)

        def off(at_place: PlanningScene, way: Vector) -> PlanResult:
            x, y, z = (self.distance * w for w in way)
            above = T_world_tcp.shifted(x, y, z)
            return straight(at_place, gripper.arm_group, gripper.tcp_link, above, self.speed)

        yield from ways_down(
            draft, planning, scene, gripper, T_world_tcp, self.name, placement.name, up, placement=placement
        )


Surface = tuple[SE3, float, float]
"""The frame (z along its normal) and the size x, y [m] of what an object is put on."""


def surface_of_place(support: CollisionObject, placement: Placement) -> Surface:
    """The surface that a placement is on."""
    return support_surface(support, float(np.arccos(min(placement.normal[2], 1.0))) + 1e-6)


def hand_in_support(hand: Hand, T_world_tcp: SE3, surface: Surface) -> float:
    """How far [m] a hand's corners would be below a surface, where that is."""
    low, high = hand.boxes[:, :3], hand.boxes[:, 3:]
    corners = np.concatenate([np.where(pick, high, low) for pick in np.ndindex(2, 2, 2)])
    frame, size_x, size_y = surface
    at = frame.inv().apply(T_world_tcp.apply(corners))
    above = np.all(np.abs(at[:, :2]) < np.array([size_x, size_y]) / 2, axis=1)
    return float(-at[above, 2].min()) if above.any() else 0.0


def ways_down(
    draft: Draft, planning: Planning, scene: PlanningScene, gripper: Gripper, T_world_tcp: SE3, stage: str,
    candidate: str, up: Callable[[PlanningScene], PlanResult], *steps: Step, **data: Any,
) -> Iterator[Draft]:  # fmt: skip
    """Ways to come down to a place, each ending in another arm state; what cannot be is rejected by reason.

    Args:
        scene: with the contacts of the place allowed.
        up: plans the way backwards, from the scene at the place.
        steps, data: for the drafts, besides `candidate`, `pre_place`, `lower` and `after_lower`.
    """
    for arm in reachable(scene, gripper, T_world_tcp, planning, stage, candidate):
        result = up(scene.with_state(arm))
        if not result.ok or result.trajectory is None:
            planning.reject("lower", candidate, result.message)
            continue
        lower = reversed_in_time(result.trajectory)
        yield draft.then(
            *steps,
            candidate=candidate,
            pre_place=lower.positions[0],
            lower=Motion(
                "lower",
                lower,
                "cartesian",
                result.planning_time,
                result.min_clearance,
                scene,
                {"planned": "backwards", **result.evidence},
            ),
            after_lower=draft.scene.with_state(arm),
            **data,
        )


@dataclass(frozen=True, eq=False)
class Open:
    """Open wide enough to leave; the object belongs to the world again."""

    object: str
    support: str
    gripper: Gripper
    margin: float  # [m] wider than now, if there is room
    settle: float
    name: str = "open"

    @property
    def needs(self) -> tuple[str, ...]:
        return (holding(self.object),)

    @property
    def takes(self) -> tuple[str, ...]:
        return (holding(self.object),)

    def drafts(self, draft: Draft, planning: Planning) -> Iterator[Draft]:
        now = self.gripper.width(draft.scene.state[self.gripper.joint_name])
        detached = draft.scene.with_detached(self.object)
        widths = [min(now + share * self.margin, self.gripper.max_width) for share in (1.0, 0.5, 0.25)]
        for width in dict.fromkeys(widths):  # less where a finger would open into something
            yield draft.then(
                StillHeld(self.object, self.gripper),
                Grip("open", self.gripper, width, self.gripper.max_force, self.settle),
                Release(self.object),
                Watch(self.object, on=False),
                scene=detached.with_state(finger_state(self.gripper, width)),
            )


@dataclass(frozen=True, eq=False)
class ExpectSupport:
    """The object has come along; from here on it may touch its support."""

    object: str
    support: str
    gripper: Gripper
    name: str = "expect support"

    @property
    def needs(self) -> tuple[str, ...]:
        return (holding(self.object),)

    def drafts(self, draft: Draft, planning: Planning) -> Iterator[Draft]:
        yield draft.then(StillHeld(self.object, self.gripper), Expect(self.object, (self.support,)))
