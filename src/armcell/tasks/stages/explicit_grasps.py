"""Stages for grasps and placements that the caller specifies, as in MoveIt's messages."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from armcell.collision import neighbors
from armcell.core import SE3, ErrorCode, PlanResult
from armcell.grasping import RELEASE_GAP, Grasp
from armcell.model import Gripper
from armcell.scene import PlanningScene
from armcell.tasks.search import PartialSolution, SearchState, stage_types
from armcell.tasks.settings import Speed
from armcell.tasks.stages.grasp import APPROACH, approaches
from armcell.tasks.stages.moves import plan_straight, with_contacts, with_motion
from armcell.tasks.stages.place import DESCENT, descents
from armcell.tasks.steps import CheckStillHeld, ExpectContact
from armcell.tasks.task import holding_condition

UNDER = 0.006  # [m] bodies this close to a placement are its supports

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class GripperTranslation:
    """Straight motion of the gripper before or after an explicit grasp, in the world frame, as in
    moveit_msgs/GripperTranslation.
    """

    desired: Vector  # [m] translation
    minimum: float = 0.0  # [m] shorter motions fail; 0: only the full translation succeeds

    def accepted(self, result: PlanResult) -> PlanResult:
        """Return the result of planning the straight approach or retreat of an explicit grasp. If the motion
        covers at least the minimum distance, mark the result as a success.
        """
        done = result.fraction * float(np.linalg.norm(self.desired))
        if result.trajectory is not None and 0 < self.minimum <= done + 1e-6:
            return replace(result, code=ErrorCode.SUCCESS)
        return result


@dataclass(frozen=True, eq=False)
class ExplicitGrasp(Grasp):
    """Explicit grasp that the caller specifies, with its own approach and retreat in the world frame."""

    pre_grasp_approach: GripperTranslation = GripperTranslation((0.0, 0.0, -0.1))
    post_grasp_retreat: GripperTranslation = GripperTranslation((0.0, 0.0, 0.1))


@stage_types.register("use_grasps")
@dataclass(frozen=True, eq=False)
class UseGrasps:
    """Stage that proposes the caller's explicit grasps in list order,
    if they are reachable and have a free approach.
    """

    object: str
    gripper: Gripper
    grasps: tuple[ExplicitGrasp, ...]
    speed: Speed
    name: str = "grasp"
    provides = APPROACH

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        for grasp in self.grasps:
            back = partial(self._backward, grasp.pre_grasp_approach)
            yield from approaches(solution, planning, self.name, self.object, self.gripper, grasp, back)

    def _backward(
        self, approach: GripperTranslation, at_grasp: PlanningScene, T_world_tcp: SE3
    ) -> PlanResult:
        back = _moved_by(T_world_tcp, approach.desired, -1.0)
        return approach.accepted(
            plan_straight(at_grasp, self.gripper.arm_group, self.gripper.tcp_link, back, self.speed)
        )


@stage_types.register("lift")
@dataclass(frozen=True, eq=False)
class Lift:
    """Stage that lifts the object from its support with the post-grasp retreat that the explicit grasp
    specifies.
    """

    object: str
    gripper: Gripper
    supports: tuple[str, ...]
    speed: Speed
    name: str = "lift"
    requires = ("grasp",)

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        grasp: ExplicitGrasp = solution.data["grasp"]
        gripper = self.gripper
        scene = with_contacts(solution.scene, ((self.object, self.supports),))
        target = _moved_by(scene.frame_pose(gripper.tcp_link), grasp.post_grasp_retreat.desired)
        result = grasp.post_grasp_retreat.accepted(
            plan_straight(scene, gripper.arm_group, gripper.tcp_link, target, self.speed)
        )
        yield from with_motion(solution, planning, self.name, result, planned_in=scene)


@dataclass(frozen=True, eq=False)
class ExplicitPlacement:
    """Explicit placement that the caller specifies: the target pose,
    and the motions before and after the release.

    Pose and motions are in the world frame.
    """

    name: str
    T_world_object: SE3
    down: GripperTranslation = GripperTranslation((0.0, 0.0, -0.08))
    away: GripperTranslation | None = None  # None: back along the hand's own axis


@stage_types.register("use_placements")
@dataclass(frozen=True, eq=False)
class UsePlacements:
    """Stage that proposes the caller's explicit placements in list order,
    if a straight descent to them is free.
    """

    object: str
    gripper: Gripper
    places: tuple[ExplicitPlacement, ...]
    speed: Speed
    name: str = "placement"
    provides = (*DESCENT, "place")

    @property
    def requires(self) -> tuple[str, ...]:
        return (holding_condition(self.object),)

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        for place in self.places:
            yield from self._descents(solution, planning, place)

    def _descents(
        self, solution: PartialSolution, planning: SearchState, place: ExplicitPlacement
    ) -> Iterator[PartialSolution]:
        gripper = self.gripper
        supports = resting_contacts(solution.scene, self.object, place.T_world_object)
        T_tcp_object = solution.scene.frame_pose(gripper.tcp_link).inverse() @ solution.scene.frame_pose(
            self.object
        )
        T_world_tcp = place.T_world_object.shifted(z=RELEASE_GAP) @ T_tcp_object.inverse()
        scene = with_contacts(solution.scene, ((self.object, supports),))

        def up(at_place: PlanningScene) -> PlanResult:
            above = _moved_by(T_world_tcp, place.down.desired, -1.0)
            return place.down.accepted(
                plan_straight(at_place, gripper.arm_group, gripper.tcp_link, above, self.speed)
            )

        steps = CheckStillHeld(self.object, gripper), ExpectContact(self.object, supports)
        yield from descents(
            solution, planning, scene, gripper, T_world_tcp, self.name, place.name, up, *steps, place=place
        )


@stage_types.register("retreat")
@dataclass(frozen=True, eq=False)
class Retreat:
    """Stage that moves the hand away from the object after releasing it at a caller-specified placement.

    It uses the retreat of the placement, or else moves straight along the hand's axis.
    """

    object: str
    gripper: Gripper
    distance: float  # [m] if the placement specifies no retreat
    speed: Speed
    name: str = "retreat"
    requires = ("place",)

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        place: ExplicitPlacement = solution.data["place"]
        gripper = self.gripper
        scene = with_contacts(solution.scene, ((self.object, gripper.hand_links),))
        tcp = scene.frame_pose(gripper.tcp_link)
        back = tcp.rotation.matrix @ np.array([0.0, 0.0, -self.distance])
        away = place.away or GripperTranslation(
            (float(back[0]), float(back[1]), float(back[2])), self.distance / 2
        )
        target = _moved_by(tcp, away.desired)
        result = away.accepted(plan_straight(scene, gripper.arm_group, gripper.tcp_link, target, self.speed))
        yield from with_motion(solution, planning, self.name, result, planned_in=scene)


def resting_contacts(scene: PlanningScene, item: str, T_world_object: SE3) -> tuple[str, ...]:
    """Return the bodies that a held object will touch at the target pose of an explicit placement."""
    put = scene.with_detached(item).with_object_pose(item, T_world_object)
    return tuple(neighbors(put, item, UNDER))


def _moved_by(T: SE3, offset: Vector, sign: float = 1.0) -> SE3:
    return replace(T, translation=T.translation + sign * np.asarray(offset))
