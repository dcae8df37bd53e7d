"""Handover of an object from one arm to another: meet, grasp, release, retreat."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from armcell.core import SE3, SO3, InputError, Outcome
from armcell.kinematics import kinematic_tree
from armcell.model import Gripper
from armcell.scene import PlanningScene
from armcell.tasks.context import TaskContext
from armcell.tasks.pick import check_hand_is_free, grasp_stages
from armcell.tasks.search import PartialSolution, SearchState, Stage, stage_types
from armcell.tasks.stages import ChooseGrasp, Close, Connect, MoveStraight
from armcell.tasks.stages.grasp import finger_state, reachable
from armcell.tasks.steps import CheckStillHeld, CommandGripper, ExpectContact, perform_all
from armcell.tasks.task import holding_condition, plan_stages

TURNS = (0.0, np.pi / 2, -np.pi / 2, np.pi)  # [rad] rotations about the vertical tried at a meeting point
RISES = (0.15, 0.3, 0.0)  # [m] above the object's present height


def hand_over(ctx: TaskContext, item: str, receiver: Gripper, at: Sequence[SE3] = ()) -> Outcome:
    """Hand an object over from one arm to another. All motions are planned before the first one starts.

    Args:
        at: candidate poses T_world_object, best first; default: half-way between the arms' bases.
    Returns:
        SUCCESS with the receiver's grasp in the evidence ("grasp"), or the failure with all rejections.
    Raises:
        InputError: no hand holds the object, or the receiver already holds one.
    """
    if item not in ctx.holding:
        raise InputError(f"no hand holds {item!r}", hint="pick it first")
    giver, s = ctx.holding[item].gripper, ctx.settings
    if giver.name == receiver.name:
        raise InputError(f"{receiver.name!r} holds {item!r} already", hint="name the other arm")
    check_hand_is_free(ctx, receiver)
    scene = ctx.scene()
    poses = tuple(at) or _half_way(scene, item, giver, receiver)
    stages: list[Stage] = [
        ChooseMeetingPose(item, giver, poses),
        Connect("bring to the other arm", giver.arm_group, s.carry, target="meeting"),
        OfferObject(item, giver),
        *grasp_stages(
            ChooseGrasp(item, receiver, s.near, s.approach_distance), receiver, s,
            Close(item, receiver, (), s.grasp_settle),
        ),
        OpenGiver(item, giver, s.release_margin, s.release_settle),
        MoveStraight("retreat", giver.arm_group, giver.tcp_link, s.near, (0.0, 0.0, -s.retreat_distance),
                 in_tip_frame=True, allow=((item, giver.hand_links),)),
    ]  # fmt: skip
    solution, outcome = plan_stages(ctx, stages, f"hand over {item}")
    if solution is None:
        return outcome
    done = perform_all(ctx, (*solution.steps, ExpectContact(item, giver.contact_links, expected=False)))
    return replace(done, evidence={**done.evidence, "grasp": solution.data["grasp"]})


def _half_way(scene: PlanningScene, item: str, giver: Gripper, receiver: Gripper) -> tuple[SE3, ...]:
    """Return candidate poses of an object at which one arm can hand it to another,
    halfway between the bases of the two arms.

    The candidates have several rotations and heights.
    """
    model, tree = scene.model, kinematic_tree(scene.model)
    bases = [
        tree.link_pose(scene.positions, model.joints[model.group(g.arm_group).joint_names[0]].parent)
        for g in (giver, receiver)
    ]
    x, y = ((bases[0].translation + bases[1].translation) / 2)[:2]
    now = scene.object(item).T_world_object
    return tuple(
        SE3(SO3.exp((0.0, 0.0, turn)) @ now.rotation, np.array([x, y, now.translation[2] + rise]))
        for rise in RISES
        for turn in TURNS
    )


@stage_types.register("choose_meeting_pose")
@dataclass(frozen=True, eq=False)
class ChooseMeetingPose:
    """Handover stage that proposes states in which the giving arm holds the object at a meeting pose."""

    object: str
    giver: Gripper
    poses: tuple[SE3, ...]
    name: str = "meeting"
    provides = ("candidate", "meeting")

    @property
    def requires(self) -> tuple[str, ...]:
        return (holding_condition(self.object),)

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        scene, tcp = solution.scene, self.giver.tcp_link
        T_object_tcp = scene.frame_pose(self.object).inverse() @ scene.frame_pose(tcp)
        for i, pose in enumerate(self.poses):
            candidate = f"meeting {i + 1}"
            target = pose @ T_object_tcp
            for arm in reachable(scene, self.giver, target, planning, self.name, candidate):
                yield solution.then(
                    CheckStillHeld(self.object, self.giver), candidate=candidate, meeting=arm.positions
                )


@stage_types.register("offer_object")
@dataclass(frozen=True, eq=False)
class OfferObject:
    """Handover stage that detaches the object from the giver's hand in the planning scene. The object then
    rests between the giver's fingers.
    """

    object: str
    giver: Gripper
    name: str = "offer"

    @property
    def consumes(self) -> tuple[str, ...]:
        return (holding_condition(self.object),)

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        scene = solution.scene.with_detached(self.object)
        yield solution.then(scene=scene.with_allowed(self.object, self.giver.hand_links))


@stage_types.register("open_giver")
@dataclass(frozen=True, eq=False)
class OpenGiver:
    """Handover stage that opens the giver's gripper a little once the receiver holds the object,
    so that the giver can retreat.
    """

    object: str
    giver: Gripper
    margin: float  # [m] wider than now
    settle: float
    name: str = "yield"

    def propose(self, solution: PartialSolution, planning: SearchState) -> Iterator[PartialSolution]:
        width = self.giver.width_in(solution.scene.state) + self.margin
        width = min(width, self.giver.max_width)
        yield solution.then(
            CommandGripper("let go", self.giver, width, self.giver.max_force, self.settle),
            scene=solution.scene.with_state(finger_state(self.giver, width)),
        )
