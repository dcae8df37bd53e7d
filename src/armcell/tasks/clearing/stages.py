"""Stages of clearing a bin: a grasp of the heap, and where to put what comes up."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from armcell.core import SE3, SO3, Box, PlanResult
from armcell.grasping import HeapGrasp
from armcell.model import Gripper
from armcell.scene import CollisionObject, PlanningScene
from armcell.tasks.clearing.steps import HELD, Drop, Squeeze, StillThere
from armcell.tasks.interfaces import holding
from armcell.tasks.search import Draft, Planning
from armcell.tasks.settings import Speed
from armcell.tasks.stages.grasp import APPROACH, approaches, finger_state
from armcell.tasks.stages.moves import shifted, straight, with_contacts
from armcell.tasks.stages.place import DESCENT, ways_down

HEAP = "heap"
"""Name in the planning scene of the points that a camera saw in the bin."""
WIDEST = 0.06  # [m] half the length a held thing is thought to have at most


@dataclass(frozen=True, eq=False)
class ChooseFromHeap:
    """Those grasps that can be reached, with their way straight down, in their order."""

    grasps: Sequence[HeapGrasp]
    gripper: Gripper
    speed: Speed
    distance: float  # [m] of the approach
    name: str = "grasp"
    gives = APPROACH

    def drafts(self, draft: Draft, planning: Planning) -> Iterator[Draft]:
        for grasp in self.grasps:
            yield from approaches(draft, planning, self.name, HEAP, self.gripper, grasp, self._back)

    def _back(self, at_grasp: PlanningScene, T_world_tcp: SE3) -> PlanResult:
        up = shifted(T_world_tcp, (0.0, 0.0, -self.distance), in_own_frame=True)
        return straight(at_grasp, self.gripper.arm_group, self.gripper.tcp_link, up, self.speed)


@dataclass(frozen=True, eq=False)
class CloseOnHeap:
    """Close; what is thought to be between the fingers is attached."""

    gripper: Gripper
    floor: float  # [m, world z] of the bin: as far down the thing may reach
    settle: float
    thinnest: float
    name: str = "close"
    needs = ("grasp",)
    gives = (holding(HELD),)

    def drafts(self, draft: Draft, planning: Planning) -> Iterator[Draft]:
        grasp: HeapGrasp = draft.data["grasp"]
        bottom = self.floor + 0.002
        T_tcp_box = SE3.from_xyz(0.0, 0.0, _below_tcp(grasp, (grasp.top + bottom) / 2))
        half = min(grasp.reach, WIDEST)
        box = Box(2 * half, max(grasp.width, 0.004), max(grasp.top - bottom, 0.004))
        scene = draft.scene.with_state(finger_state(self.gripper, grasp.width))
        item = CollisionObject.single(
            HELD, box, scene.frame_pose(self.gripper.tcp_link) @ T_tcp_box, movable=True
        )
        scene = scene.with_object(item).with_attached(HELD, self.gripper.tcp_link, self.gripper.hand_links)
        yield draft.then(
            Squeeze(self.gripper, grasp.force, self.settle, self.thinnest, box, T_tcp_box), scene=scene
        )


def _below_tcp(grasp: HeapGrasp, z: float) -> float:
    """How far a height [m, world] is below the tcp of a hand that points down."""
    return float(grasp.T_object_tcp.translation[2]) - z


@dataclass(frozen=True, eq=False)
class ChooseSpot:
    """Places (x, y and the height under them) above which the hand opens, in their order."""

    spots: Sequence[tuple[float, float, float]]  # [m, world]
    hang: float  # [m] that the held thing reaches below the tcp
    gripper: Gripper
    speed: Speed
    distance: float  # [m] of the way down
    turns: int = 8
    name: str = "spot"
    gives = DESCENT

    def drafts(self, draft: Draft, planning: Planning) -> Iterator[Draft]:
        gripper = self.gripper
        now = draft.scene.frame_pose(gripper.tcp_link).rotation
        for x, y, under in self.spots:
            for k in range(self.turns):
                R = SO3.exp((0.0, 0.0, 2 * np.pi * k / self.turns)) @ now
                T = SE3(R, np.array([x, y, under + self.hang]))
                name = f"({x:.2f}, {y:.2f}) at {360 // self.turns * k} deg"
                up = partial(self._up, T)
                yield from ways_down(draft, planning, draft.scene, gripper, T, self.name, name, up)

    def _up(self, T_world_tcp: SE3, at_spot: PlanningScene) -> PlanResult:
        above = T_world_tcp.shifted(z=self.distance)
        return straight(at_spot, self.gripper.arm_group, self.gripper.tcp_link, above, self.speed)


@dataclass(frozen=True, eq=False)
class OpenAbove:
    """Open the hand and let go of what is in it."""

    gripper: Gripper
    margin: float  # [m] wider than now
    settle: float
    thinnest: float
    name: str = "open"
    needs = (holding(HELD),)
    takes = (holding(HELD),)

    def drafts(self, draft: Draft, planning: Planning) -> Iterator[Draft]:
        joint = draft.scene.state[self.gripper.joint_name]
        width = min(self.gripper.width(joint) + self.margin, self.gripper.max_width)
        scene = draft.scene.with_detached(HELD).without_object(HELD)
        yield draft.then(
            StillThere(self.gripper, self.thinnest),
            Drop(self.gripper, width, self.settle),
            scene=with_contacts(
                scene.with_state(finger_state(self.gripper, width)), ((HEAP, self.gripper.hand_links),)
            ),
        )
