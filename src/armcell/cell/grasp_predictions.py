"""Is P(success) of a proof borne out? A whole robot picks, with grasps drawn at random, what differs a little
from what it was planned for: in pose, friction and mass, by as much as the proof says that it may."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from armcell.cell.live import LiveCell
from armcell.cell.perceiving import PerceivingDriver, Seen
from armcell.control import DriverOptions, drivers
from armcell.core import SE3, Outcome
from armcell.grasping import Grasp, grasp_quality
from armcell.model import Gripper
from armcell.scene import CollisionObject, PlanningScene
from armcell.sim import PhysicsSettings, SimWorld
from armcell.tasks import Stage, TaskContext, TaskSettings, as_it_may_be, hold, pick_stages, prove, varied
from armcell.tasks.proof import MAX_SLIP, MAX_TURN
from armcell.tasks.recipes import planned
from armcell.tasks.stages import Close, Do
from armcell.tasks.steps import DONE, perform_all

POOL = 40  # grasps that differ, of which some are drawn
IN_VAIN = 3  # times as many are drawn as are wanted, since some have no way to them


@dataclass(frozen=True)
class Held:
    """What became of an object that was picked and held."""

    to_the_end: bool
    slip_m: float | None = None  # since the hand closed, of the object's point between the pads
    turn_rad: float | None = None
    reason: str = ""

    @property
    def firmly(self) -> bool:
        """As a proof counts it: what has moved farther in the hand cannot be placed well."""
        if not self.to_the_end or self.slip_m is None or self.turn_rad is None:
            return False
        return self.slip_m <= MAX_SLIP and self.turn_rad <= MAX_TURN


@dataclass(frozen=True)
class Prediction:
    """What was predicted of a grasp, and what happened."""

    grasp: str
    probability: float  # by the proof
    epsilon: float
    success: bool  # `Held.firmly`
    held: Held


def predictions(
    scene: PlanningScene, item: CollisionObject, gripper: Gripper, grasps: Sequence[Grasp],
    settings: TaskSettings, count: int, duration: float, seed: Sequence[int],
) -> list[Prediction]:  # fmt: skip
    """A trial with each of so many grasps, drawn from those that differ; fewer where few have a way to them.

    Args:
        scene: as it is believed to be, with the object.
        duration: [s] that the object is held after the lift.
        seed: of the draw and of what the object really is, by itself: the proofs must not have seen it.
    """
    rng, pool = np.random.default_rng(seed), varied(grasps, POOL)
    drawn = [pool[i] for i in rng.permutation(len(pool))[: IN_VAIN * count]]
    truths = as_it_may_be(item, len(drawn) + 1, rng)[1:]  # the first is as believed
    found: list[Prediction] = []
    for grasp, truth in zip(drawn, truths, strict=True):
        if len(found) == count:
            break
        held = held_in_truth(scene, truth, gripper, grasp, settings, duration)
        if held is None:
            continue
        (proof,) = prove(scene.model, gripper, item, [grasp], settings.proof_trials)
        epsilon = grasp_quality(item, grasp).epsilon
        found.append(Prediction(grasp.name, proof.probability, epsilon, held.firmly, held))
    return found


def held_in_truth(
    scene: PlanningScene, truth: CollisionObject, gripper: Gripper, grasp: Grasp, settings: TaskSettings,
    duration: float,
) -> Held | None:  # fmt: skip
    """Pick, lift and hold an object [s] with one grasp, planned in a scene that has it otherwise than it is.

    The robot goes by the scene, as a real one goes by what a camera saw. None where it finds no way.
    """
    name = truth.name
    believed = scene.object(name)
    seen = Seen({name: believed})
    options = DriverOptions(physics=PhysicsSettings())
    robot = drivers["sim"](scene.with_object(truth), options)
    driver: Any = PerceivingDriver(robot, scene.model, seen)
    with LiveCell("grasp prediction", scene, driver, settings, (), 0, seen=seen) as live:
        seen.poses[name] = believed.T_world_object
        live.ctx.change_scene(seen.put_into)
        hand = _Hand(driver.world, gripper, name)
        draft, _ = planned(live.ctx, _stages(live.ctx, name, gripper, grasp, hand), f"pick {name}")
        if draft is None:
            return None
        outcome = perform_all(live.ctx, draft.steps)
        if outcome.ok:
            outcome = hold(live.ctx, duration)
        return hand.held(outcome)


def _stages(ctx: TaskContext, item: str, gripper: Gripper, grasp: Grasp, hand: _Hand) -> list[Stage]:
    """Those of a pick with one grasp; between closing and lifting it is noted how the object lies."""
    stages = pick_stages(ctx.scene(), item, gripper, ctx.settings, among=(grasp.name,))
    closed = next(i for i, stage in enumerate(stages) if isinstance(stage, Close))
    return [*stages[: closed + 1], Do("closed", (hand,)), *stages[closed + 1 :]]


class _Hand:
    """How an object really lies in a hand, which no planner is told."""

    def __init__(self, world: SimWorld, gripper: Gripper, item: str):
        self._world, self._gripper, self._item = world, gripper, item
        self._closed: SE3 | None = None  # T_tcp_object

    def perform(self, ctx: TaskContext) -> Outcome:
        """A step: from here on it is measured."""
        self._closed = self._now()
        return DONE

    def _now(self) -> SE3:
        return self._world.link_pose(self._gripper.tcp_link).inv() @ self._world.object_pose(self._item)

    def held(self, outcome: Outcome) -> Held:
        """What became of it, after the lift and the hold."""
        if self._closed is None:
            return Held(False, reason=outcome.message)
        moved = self._now() @ self._closed.inv()  # in the tcp's frame
        slip, turn = moved.distance_to(SE3.identity())
        between = self._world.gripper_state(self._gripper.name).held == self._item
        reason = outcome.message or ("" if between else "nothing is between the fingers")
        return Held(outcome.ok and between, slip, turn, reason)
