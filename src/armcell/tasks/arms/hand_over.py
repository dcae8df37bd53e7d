"""One arm hands an object to the other: bring it to where both reach it, take hold, let go, draw back."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from armcell.core import SE3, SO3, InputError, Outcome
from armcell.kinematics import kinematic_tree
from armcell.model import Gripper
from armcell.scene import PlanningScene
from armcell.tasks.context import TaskContext
from armcell.tasks.interfaces import holding
from armcell.tasks.recipes import planned
from armcell.tasks.search import Draft, Planning, Stage
from armcell.tasks.stages import ChooseGrasp, Close, Connect, Planned, Straight
from armcell.tasks.stages.grasp import finger_state, reachable
from armcell.tasks.steps import Expect, Grip, StillHeld, perform_all

TURNS = (0.0, np.pi / 2, -np.pi / 2, np.pi)  # [rad] about the vertical that are tried at a meeting point
RISES = (0.15, 0.3, 0.0)  # [m] above where the object is


def hand_over(ctx: TaskContext, item: str, taker: Gripper, at: Sequence[SE3] = ()) -> Outcome:
    """Give an object that one hand holds to another hand, in the air. All of it is planned before it begins.

    Args:
        at: poses T_world_object to meet at, the best first; by default half-way between the arms' bases.
    Returns:
        SUCCESS with the taker's grasp in the evidence ("grasp"), or the failure with what was rejected.
    Raises:
        InputError: nobody holds the object, or the taker holds something.
    """
    if item not in ctx.holding:
        raise InputError(f"no hand holds {item!r}", cure="pick it first")
    giver, s = ctx.holding[item].gripper, ctx.settings
    if giver.name == taker.name:
        raise InputError(f"{taker.name!r} holds {item!r} already", cure="name the other arm")
    for held in ctx.holding.values():
        if held.gripper.name == taker.name:
            raise InputError(f"gripper {taker.name!r} already holds {held.object}", cure="place it first")
    scene = ctx.scene()
    poses = tuple(at) or _half_way(scene, item, giver, taker)
    stages: list[Stage] = [
        Meet(item, giver, poses),
        Connect("bring to the other arm", giver.arm_group, s.carry, target="meeting"),
        Offer(item, giver),
        ChooseGrasp(item, taker, s.near, s.approach_distance),
        Connect("move to pre-grasp", taker.arm_group, s.free, target="pre_grasp"),
        Planned("approach", "after_approach"),
        Close(item, taker, (), s.grasp_settle),
        Yield(item, giver, s.release_margin, s.release_settle),
        Straight("retreat", giver.arm_group, giver.tcp_link, s.near, (0.0, 0.0, -s.retreat_distance),
                 in_tip_frame=True, allow=((item, giver.hand_links),)),
    ]  # fmt: skip
    draft, outcome = planned(ctx, stages, f"hand over {item}")
    if draft is None:
        return outcome
    done = perform_all(ctx, (*draft.steps, Expect(item, giver.finger_links, expected=False)))
    return replace(done, evidence={**done.evidence, "grasp": draft.data["grasp"]})


def _half_way(scene: PlanningScene, item: str, giver: Gripper, taker: Gripper) -> tuple[SE3, ...]:
    """The object as it is now, half-way between the arms' bases, turned and lifted in several ways."""
    model, tree = scene.model, kinematic_tree(scene.model)
    bases = [
        tree.link_pose(scene.positions, model.joints[model.group(g.arm_group).joint_names[0]].parent)
        for g in (giver, taker)
    ]
    x, y = ((bases[0].translation + bases[1].translation) / 2)[:2]
    now = scene.object(item).T_world_object
    return tuple(
        SE3(SO3.exp((0.0, 0.0, turn)) @ now.rotation, np.array([x, y, now.translation[2] + rise]))
        for rise in RISES
        for turn in TURNS
    )


@dataclass(frozen=True, eq=False)
class Meet:
    """Arm states of the giver with the object at one of several poses."""

    object: str
    giver: Gripper
    poses: tuple[SE3, ...]
    name: str = "meeting"
    gives = ("candidate", "meeting")

    @property
    def needs(self) -> tuple[str, ...]:
        return (holding(self.object),)

    def drafts(self, draft: Draft, planning: Planning) -> Iterator[Draft]:
        scene, tcp = draft.scene, self.giver.tcp_link
        T_object_tcp = scene.frame_pose(self.object).inv() @ scene.frame_pose(tcp)
        for i, pose in enumerate(self.poses):
            candidate = f"meeting {i + 1}"
            target = pose @ T_object_tcp
            for arm in reachable(scene, self.giver, target, planning, self.name, candidate):
                yield draft.then(
                    StillHeld(self.object, self.giver), candidate=candidate, meeting=arm.positions
                )


@dataclass(frozen=True, eq=False)
class Offer:
    """The object is where it is brought to: for the taker it stands there, in the giver's fingers."""

    object: str
    giver: Gripper
    name: str = "offer"

    @property
    def takes(self) -> tuple[str, ...]:
        return (holding(self.object),)

    def drafts(self, draft: Draft, planning: Planning) -> Iterator[Draft]:
        scene = draft.scene.with_detached(self.object)
        yield draft.then(scene=scene.with_allowed(self.object, self.giver.hand_links))


@dataclass(frozen=True, eq=False)
class Yield:
    """The giver opens wide enough to leave, once the taker holds the object."""

    object: str
    giver: Gripper
    margin: float  # [m] wider than now
    settle: float
    name: str = "yield"

    def drafts(self, draft: Draft, planning: Planning) -> Iterator[Draft]:
        width = self.giver.width(draft.scene.state[self.giver.joint_name]) + self.margin
        width = min(width, self.giver.max_width)
        yield draft.then(
            Grip("let go", self.giver, width, self.giver.max_force, self.settle),
            scene=draft.scene.with_state(finger_state(self.giver, width)),
        )
