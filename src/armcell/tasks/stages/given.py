"""Stages where the caller says how to pick and place: grasps and places as MoveIt's messages have them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from armcell.collision import neighbours
from armcell.core import SE3, ErrorCode, PlanResult
from armcell.grasping import RELEASE_GAP, Grasp
from armcell.model import Gripper
from armcell.scene import PlanningScene
from armcell.tasks.interfaces import holding
from armcell.tasks.search import Draft, Planning
from armcell.tasks.settings import Speed
from armcell.tasks.stages.grasp import APPROACH, approaches
from armcell.tasks.stages.moves import moved, straight, with_contacts
from armcell.tasks.stages.place import DESCENT, ways_down
from armcell.tasks.steps import Expect, StillHeld

UNDER = 0.006  # [m] what is that near to a place is what the object will stand on

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Way:
    """A straight motion of the tip in the world: as long as wanted, or at least `least` [m] of it."""

    offset: Vector  # [m]
    least: float = 0.0

    def judged(self, result: PlanResult) -> PlanResult:
        """A motion along it, successful where enough of it can be done."""
        done = result.fraction * float(np.linalg.norm(self.offset))
        if result.trajectory is not None and 0 < self.least <= done + 1e-6:
            return replace(result, code=ErrorCode.SUCCESS)
        return result


@dataclass(frozen=True, eq=False)
class GivenGrasp(Grasp):
    """A grasp with its own approach and lift, both in the world."""

    way_in: Way = Way((0.0, 0.0, -0.1))
    way_out: Way = Way((0.0, 0.0, 0.1))


@dataclass(frozen=True, eq=False)
class ChooseGivenGrasp:
    """Those of the given grasps that can be reached and whose approach is free, in their order."""

    object: str
    gripper: Gripper
    grasps: tuple[GivenGrasp, ...]
    speed: Speed
    name: str = "grasp"
    gives = APPROACH

    def drafts(self, draft: Draft, planning: Planning) -> Iterator[Draft]:
        for grasp in self.grasps:
            back = partial(self._backwards, grasp.way_in)
            yield from approaches(draft, planning, self.name, self.object, self.gripper, grasp, back)

    def _backwards(self, way: Way, at_grasp: PlanningScene, T_world_tcp: SE3) -> PlanResult:
        back = _moved_by(T_world_tcp, way.offset, -1.0)
        return way.judged(straight(at_grasp, self.gripper.arm_group, self.gripper.tcp_link, back, self.speed))


@dataclass(frozen=True, eq=False)
class Lift:
    """The straight way that the chosen grasp gives, away from what the object stands on."""

    object: str
    gripper: Gripper
    supports: tuple[str, ...]
    speed: Speed
    name: str = "lift"
    needs = ("grasp",)

    def drafts(self, draft: Draft, planning: Planning) -> Iterator[Draft]:
        grasp: GivenGrasp = draft.data["grasp"]
        gripper = self.gripper
        scene = with_contacts(draft.scene, ((self.object, self.supports),))
        target = _moved_by(scene.frame_pose(gripper.tcp_link), grasp.way_out.offset)
        result = grasp.way_out.judged(
            straight(scene, gripper.arm_group, gripper.tcp_link, target, self.speed)
        )
        yield from moved(draft, planning, self.name, result, planned_in=scene)


@dataclass(frozen=True, eq=False)
class GivenPlace:
    """Where an object is to be put, how it comes there and how the hand leaves (in the world)."""

    name: str
    T_world_object: SE3
    down: Way = Way((0.0, 0.0, -0.08))
    away: Way | None = None  # back out of the hand's own direction where None


@dataclass(frozen=True, eq=False)
class ChooseGivenPlace:
    """Those of the given places that can be reached by their own straight way, in their order."""

    object: str
    gripper: Gripper
    places: tuple[GivenPlace, ...]
    speed: Speed
    name: str = "placement"
    gives = (*DESCENT, "place")

    @property
    def needs(self) -> tuple[str, ...]:
        return (holding(self.object),)

    def drafts(self, draft: Draft, planning: Planning) -> Iterator[Draft]:
        for place in self.places:
            yield from self._ways_down(draft, planning, place)

    def _ways_down(self, draft: Draft, planning: Planning, place: GivenPlace) -> Iterator[Draft]:
        gripper = self.gripper
        supports = standing_on(draft.scene, self.object, place.T_world_object)
        T_tcp_object = draft.scene.frame_pose(gripper.tcp_link).inv() @ draft.scene.frame_pose(self.object)
        T_world_tcp = place.T_world_object.shifted(z=RELEASE_GAP) @ T_tcp_object.inv()
        scene = with_contacts(draft.scene, ((self.object, supports),))

        def up(at_place: PlanningScene) -> PlanResult:
            above = _moved_by(T_world_tcp, place.down.offset, -1.0)
            return place.down.judged(
                straight(at_place, gripper.arm_group, gripper.tcp_link, above, self.speed)
            )

        steps = StillHeld(self.object, gripper), Expect(self.object, supports)
        yield from ways_down(
            draft, planning, scene, gripper, T_world_tcp, self.name, place.name, up, *steps, place=place
        )


@dataclass(frozen=True, eq=False)
class Leave:
    """Away from the object that was put down: as the place says, else back out of the hand's direction."""

    object: str
    gripper: Gripper
    distance: float  # [m] where the place says nothing
    speed: Speed
    name: str = "retreat"
    needs = ("place",)

    def drafts(self, draft: Draft, planning: Planning) -> Iterator[Draft]:
        place: GivenPlace = draft.data["place"]
        gripper = self.gripper
        scene = with_contacts(draft.scene, ((self.object, gripper.hand_links),))
        tcp = scene.frame_pose(gripper.tcp_link)
        back = tcp.rotation.matrix @ np.array([0.0, 0.0, -self.distance])
        away = place.away or Way((float(back[0]), float(back[1]), float(back[2])), self.distance / 2)
        target = _moved_by(tcp, away.offset)
        result = away.judged(straight(scene, gripper.arm_group, gripper.tcp_link, target, self.speed))
        yield from moved(draft, planning, self.name, result, planned_in=scene)


def standing_on(scene: PlanningScene, item: str, T_world_object: SE3) -> tuple[str, ...]:
    """What a held object will touch where it is put."""
    put = scene.with_detached(item).with_object_pose(item, T_world_object)
    return tuple(neighbours(put, item, UNDER))


def _moved_by(T: SE3, offset: Vector, sign: float = 1.0) -> SE3:
    return replace(T, translation=T.translation + sign * np.asarray(offset))
