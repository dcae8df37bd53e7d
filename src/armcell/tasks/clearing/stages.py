"""Stages of bin clearing: choose a grasp from the heap, close, and release over the tray."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from armcell.core import SE3, SO3, Box, PlanResult
from armcell.grasping import HeapGrasp
from armcell.model import Gripper
from armcell.scene import CollisionObject, PlanningScene
from armcell.tasks.clearing.steps import HELD, Drop, GripUntilForce, StillThere
from armcell.tasks.interfaces import holding
from armcell.tasks.search import PartialSolution, Planning
from armcell.tasks.settings import Speed
from armcell.tasks.stages.grasp import APPROACH, approaches, finger_state
from armcell.tasks.stages.moves import shifted, straight, with_contacts
from armcell.tasks.stages.place import DESCENT, descents

HEAP = "heap"
"""Name of the camera's points in the bin, in the planning scene."""
WIDEST = 0.06  # [m] largest assumed half length of a held object


@dataclass(frozen=True, eq=False)
class ChooseFromHeap:
    """Stage that proposes reachable heap grasps with straight descents, in the given order."""

    grasps: Sequence[HeapGrasp]
    gripper: Gripper
    speed: Speed
    distance: float  # [m] of the approach
    name: str = "grasp"
    provides = APPROACH

    def propose(self, solution: PartialSolution, planning: Planning) -> Iterator[PartialSolution]:
        for grasp in self.grasps:
            yield from approaches(solution, planning, self.name, HEAP, self.gripper, grasp, self._back)

    def _back(self, at_grasp: PlanningScene, T_world_tcp: SE3) -> PlanResult:
        up = shifted(T_world_tcp, (0.0, 0.0, -self.distance), in_own_frame=True)
        return straight(at_grasp, self.gripper.arm_group, self.gripper.tcp_link, up, self.speed)


@dataclass(frozen=True, eq=False)
class CloseOnHeap:
    """Stage that closes the hand and attaches the assumed object between the fingers."""

    gripper: Gripper
    floor: float  # [m, world z] of the bin, lower bound of the object
    settle: float
    thinnest: float
    name: str = "close"
    requires = ("grasp",)
    provides = (holding(HELD),)

    def propose(self, solution: PartialSolution, planning: Planning) -> Iterator[PartialSolution]:
        grasp: HeapGrasp = solution.data["grasp"]
        bottom = self.floor + 0.002
        T_tcp_box = SE3.from_xyz(0.0, 0.0, _below_tcp(grasp, (grasp.top + bottom) / 2))
        half = min(grasp.reach, WIDEST)
        box = Box(2 * half, max(grasp.width, 0.004), max(grasp.top - bottom, 0.004))
        scene = solution.scene.with_state(finger_state(self.gripper, grasp.width))
        item = CollisionObject.single(
            HELD, box, scene.frame_pose(self.gripper.tcp_link) @ T_tcp_box, movable=True
        )
        scene = scene.with_object(item).with_attached(HELD, self.gripper.tcp_link, self.gripper.hand_links)
        yield solution.then(
            GripUntilForce(self.gripper, grasp.force, self.settle, self.thinnest, box, T_tcp_box), scene=scene
        )


def _below_tcp(grasp: HeapGrasp, z: float) -> float:
    """Return the depth of a height [m, world] below the TCP of a hand that points down."""
    return float(grasp.T_object_tcp.translation[2]) - z


@dataclass(frozen=True, eq=False)
class ChooseReleasePoint:
    """Stage that proposes release points (x, y, height below them) in the given order."""

    spots: Sequence[tuple[float, float, float]]  # [m, world]
    hang: float  # [m] extent of the held object below the TCP
    gripper: Gripper
    speed: Speed
    distance: float  # [m] length of the descent
    turns: int = 8
    name: str = "spot"
    provides = DESCENT

    def propose(self, solution: PartialSolution, planning: Planning) -> Iterator[PartialSolution]:
        gripper = self.gripper
        now = solution.scene.frame_pose(gripper.tcp_link).rotation
        for x, y, under in self.spots:
            for k in range(self.turns):
                R = SO3.exp((0.0, 0.0, 2 * np.pi * k / self.turns)) @ now
                T = SE3(R, np.array([x, y, under + self.hang]))
                name = f"({x:.2f}, {y:.2f}) at {360 // self.turns * k} deg"
                up = partial(self._up, T)
                yield from descents(solution, planning, solution.scene, gripper, T, self.name, name, up)

    def _up(self, T_world_tcp: SE3, at_spot: PlanningScene) -> PlanResult:
        above = T_world_tcp.shifted(z=self.distance)
        return straight(at_spot, self.gripper.arm_group, self.gripper.tcp_link, above, self.speed)


@dataclass(frozen=True, eq=False)
class OpenAbove:
    """Stage that opens the hand above the tray and releases its object."""

    gripper: Gripper
    margin: float  # [m] wider than now
    settle: float
    thinnest: float
    name: str = "open"
    requires = (holding(HELD),)
    consumes = (holding(HELD),)

    def propose(self, solution: PartialSolution, planning: Planning) -> Iterator[PartialSolution]:
        joint = solution.scene.state[self.gripper.joint_name]
        width = min(self.gripper.width(joint) + self.margin, self.gripper.max_width)
        scene = solution.scene.with_detached(HELD).without_object(HELD)
        yield solution.then(
            StillThere(self.gripper, self.thinnest),
            Drop(self.gripper, width, self.settle),
            scene=with_contacts(
                scene.with_state(finger_state(self.gripper, width)), ((HEAP, self.gripper.hand_links),)
            ),
        )
