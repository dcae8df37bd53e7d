"""Pick recipe: choose a grasp, approach, close, lift and verify, with retries.

After a failure, the recipe tries the next grasp. `Pick` is the sequence of every pick. Its subclasses supply
the parts that differ: `pick` an object at rest, `pick_moving` (`conveyor_pick.py`) one on a conveyor,
`clear_bin` (`bin_clearing/`) an unknown one in a bin, `TwoArmCarry.grasp` (`arms/`) one with two arms, and
the ROS node /pickup through a remote cell.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from armcell.collision import neighbors, resting_shift
from armcell.core import ErrorCode, InputError, Outcome
from armcell.execution import SCENE_INVALIDATED
from armcell.model import Gripper
from armcell.scene import PlanningScene
from armcell.tasks.approach import CONTACT, HandContact, shift_shown
from armcell.tasks.context import TaskContext
from armcell.tasks.search import Lookahead, PartialSolution, SearchState, Stage
from armcell.tasks.settings import TaskSettings
from armcell.tasks.stages import (
    AppendPlannedMotion,
    ChooseGrasp,
    ChoosePlacement,
    Close,
    Connect,
    LiftCheck,
    MoveStraight,
)
from armcell.tasks.stages.grasp import GraspFilter
from armcell.tasks.steps import EMPTY, perform_all
from armcell.tasks.task import holding_condition, plan_stages

AHEAD = "what comes next"  # stage of a pick that checks whether later stages are feasible with a grasp
DOUBT = 2.0  # factor on the assumed pose error after a grasp without the object
SAME_POSE = 0.002  # [m] by which a second look must move an object to correct its believed pose
WIDER = 4  # factor on the number of grasps if later stages reject many


class Pick(ABC):
    """Sequence that every pick recipe follows: plan an attempt and perform it.
    If the attempt fails, try the next grasp.

    Args:
        label: names the pick in notes and messages, for example "pick cube".
        note: reports a failed attempt, for example as an event.
        attempts: maximum number of attempts.
        excluded: names of grasps that must not be used; failed grasps are added.
    """

    retry = "trying the next grasp"  # end of the note about a failed attempt

    def __init__(
        self, label: str, note: Callable[[str], Any], attempts: int = 1, excluded: tuple[str, ...] = ()
    ):
        self.label, self.note, self.attempts, self.excluded = label, note, attempts, excluded

    def run(self) -> Outcome:
        """Plan and perform attempts of the pick until one succeeds, at most `attempts` times.

        The attempts end early if no plan is found or the pick is canceled.

        Returns:
            SUCCESS, or the last failure. After a scene change the object stays in the hand if it is grasped.
        """
        outcome, causes = Outcome(ErrorCode.FAILURE, "not tried"), list[str]()
        for left in reversed(range(self.attempts)):
            solution, outcome = self.plan()
            if solution is None:
                return replace(outcome, message=_first_cause_first([*causes, outcome.message]))
            outcome = self.perform(solution)
            if outcome.ok or outcome.code is ErrorCode.PREEMPTED:
                return outcome
            changed = outcome.code is SCENE_INVALIDATED  # the grasp is still usable
            if changed and self.keeps_object():
                return outcome
            if not changed:
                causes.append(outcome.message)
            if left:
                self.note(f"{self.label}: {outcome.message}" + ("" if changed else f"; {self.retry}"))
            corrected = self.recover(outcome)
            if not changed and not corrected:
                self.excluded = (*self.excluded, str(solution.data.get("candidate", "")))
        return replace(outcome, message=_first_cause_first(causes or [outcome.message]))

    @abstractmethod
    def plan(self) -> tuple[PartialSolution | None, Outcome]:
        """Plan one attempt of a pick from the measured state.
        If there is no plan, return None and the reason.

        Excluded grasps are not used.
        """

    @abstractmethod
    def perform(self, solution: PartialSolution) -> Outcome:
        """Execute the planned motions of a pick, and verify that the hand holds the object."""

    def keeps_object(self) -> bool:
        """Return whether the hand holds the object when a scene change stops the pick. In this case, the hand
        keeps the object and the pick ends.
        """
        return False

    def recover(self, outcome: Outcome) -> bool:
        """Prepare the next attempt after a failed pick: open the hand and retreat from the object.

        After a scene change or a contact during the approach, the hand has not closed yet. In these cases the
        hand only retreats.

        Returns:
            Whether the believed pose of the object was corrected, so that the grasp is still usable.
        """
        changed = outcome.code is SCENE_INVALIDATED
        held = False if changed or CONTACT in outcome.evidence else self.open_hand()
        if held or ((changed or EMPTY in outcome.evidence) and self.is_around_object()):
            self.back_off()
        return False

    def open_hand(self) -> bool:
        """Open the hand fully during a pick. Return whether the hand held the object until then."""
        return False

    def is_around_object(self) -> bool:
        """Return whether the open hand may still be around the object after a failed pick, so that the hand
        must retreat first.
        """
        return False

    def back_off(self) -> None:
        """Retreat straight from the object that the open hand surrounds after a failed pick."""
        return


def _first_cause_first(causes: Sequence[str]) -> str:
    """Return the message of a pick that failed in several attempts: the first cause, then the others."""
    return "; then: ".join(dict.fromkeys(causes))


def grasp_stages(
    choose: Stage, gripper: Gripper, s: TaskSettings, *rest: Stage, name: str = "move to pre-grasp",
    approach: Stage = AppendPlannedMotion("approach", "after_approach", "approach"),
) -> list[Stage]:  # fmt: skip
    """Return the stages of one pick attempt: choose a grasp, move to its pre-grasp, approach, and finish.

    Args:
        choose: proposes grasps, each with `pre_grasp` and the data that `approach` requires.
        rest: close, lift and verify.
        name: of the motion to the pre-grasp.
    """
    return [choose, Connect(name, gripper.arm_group, s.free, target="pre_grasp"), approach, *rest]


def check_hand_is_free(ctx: TaskContext, gripper: Gripper) -> None:
    """Check before a pick that a gripper holds no object.

    Raises:
        InputError: the gripper holds an object; the message names it.
    """
    for held in ctx.holding.values():
        if held.gripper.name == gripper.name:
            raise InputError(f"gripper {gripper.name!r} already holds {held.object}", hint="place it first")


def check_pickable(ctx: TaskContext, item: str, gripper: Gripper) -> None:
    """Check before a pick that the gripper is free and the object is movable.

    Raises:
        InputError: no such object, not movable, or the gripper already holds something.
    """
    check_hand_is_free(ctx, gripper)
    if not ctx.scene().object(item).movable:
        raise InputError(f"object {item!r} is fixed", hint="give it 'movable: true'")


# --- an object at rest ---
def pick(
    ctx: TaskContext, item: str, gripper: Gripper, excluded: tuple[str, ...] = (), ahead: Sequence[Stage] = ()
) -> Outcome:
    """Pick an object: grasp and lift it. If a grasp fails, try the next one.

    Args:
        excluded: names of grasps that must not be used.
        ahead: stages that must be feasible with the object in the hand; other grasps are rejected.
    Returns:
        SUCCESS with the grasp in the evidence ("grasp", and "proof" if `prove_grasps` is set), or the last
        failure with the reasons per candidate ("rejections"). If an obstacle blocks the lift, a grasped
        object stays in the hand.
    Raises:
        InputError: no such object, not movable, or the gripper already holds something.
    """
    check_pickable(ctx, item, gripper)
    return _PickAtRest(ctx, item, gripper, excluded, ahead).run()


class _PickAtRest(Pick):
    """Pick of an object at rest: plans and executes one attempt at a time, and opens the hand and retreats
    after a failure.
    """

    def __init__(
        self, ctx: TaskContext, item: str, gripper: Gripper, excluded: tuple[str, ...], ahead: Sequence[Stage]
    ):
        super().__init__(f"pick {item}", partial(ctx.emit, "note"), ctx.settings.attempts, excluded)
        self._ctx, self._item, self._gripper, self._ahead = ctx, item, gripper, ahead
        self._pose_error = ctx.settings.pose_error  # [m]

    def plan(self) -> tuple[PartialSolution | None, Outcome]:
        ctx = self._ctx
        rest_object(ctx, self._item)
        s = replace(ctx.settings, pose_error=self._pose_error)
        stages = pick_stages(ctx.scene(), self._item, self._gripper, s, self.excluded, self._ahead)
        return plan_stages(ctx, stages, self.label, settings=s)

    def perform(self, solution: PartialSolution) -> Outcome:
        outcome = perform_all(self._ctx, solution.steps)
        chosen = {"grasp": solution.data["grasp"], "proof": solution.data["proof"]}
        return replace(outcome, evidence={**outcome.evidence, **chosen})

    def keeps_object(self) -> bool:
        return self._item in self._ctx.holding

    def open_hand(self) -> bool:
        ctx, gripper = self._ctx, self._gripper
        held = ctx.holding.pop(self._item, None)
        ctx.driver.unwatch_object(self._item)
        ctx.driver.command_gripper(gripper.name, gripper.max_width, gripper.max_force)
        ctx.advance(ctx.settings.release_settle + 0.5)
        return held is not None

    def is_around_object(self) -> bool:
        return is_near(self._ctx.scene(), self._item, self._gripper, self._ctx.settings)

    def back_off(self) -> None:
        back_off(self._ctx, self._item, self._gripper)

    def recover(self, outcome: Outcome) -> bool:
        ctx, item, contact = self._ctx, self._item, outcome.evidence.get(CONTACT)
        shift, scene = np.zeros(3), ctx.scene()
        if isinstance(contact, HandContact):  # before the hand moves
            shift = shift_shown(scene, item, self._gripper, contact)
        super().recover(outcome)
        if EMPTY in outcome.evidence:  # the object may be farther from its believed pose than assumed
            self._pose_error *= DOUBT
        if ctx.look is not None and EMPTY in outcome.evidence and item in ctx.scene().objects:
            before = ctx.scene().object(item).T_world_object
            ctx.look()
            seen = ctx.scene().objects.get(item)
            return seen is not None and before.distance_to(seen.T_world_object)[0] > SAME_POSE
        if not shift.any():
            return False
        ctx.correct_pose(item, scene.object(item).T_world_object.shifted(*shift.tolist()))
        size = 1000 * float(np.linalg.norm(shift))
        text = f"the contact shows {item} at least {size:.0f} mm beside its believed pose"
        ctx.emit("note", f"{text}: corrected")
        return True


def rest_object(ctx: TaskContext, item: str) -> None:
    """Correct the believed height of an object that a task is about to pick: an object at rest touches its
    support.

    The correction is at most the setting `pose_error`.
    """
    scene = ctx.scene()
    shift = resting_shift(scene, item, ctx.settings.pose_error)
    if not shift:
        return
    T = scene.object(item).T_world_object
    ctx.correct_pose(item, T.shifted(z=shift))
    if ctx.scene().object(item).T_world_object.distance_to(T)[0] > 0:  # not measured by the driver
        way = "inside its support" if shift > 0 else "above its support"
        text = f"believed: the scene has {item} {abs(shift) * 1000:.1f} mm {way}; it rests on it"
        ctx.emit("note", f"{text}: corrected")


def pick_stages(
    scene: PlanningScene, item: str, gripper: Gripper, s: TaskSettings, excluded: tuple[str, ...] = (),
    ahead: Sequence[Stage] = (), among: tuple[str, ...] = (),
) -> list[Stage]:  # fmt: skip
    """Return the stages of the pick recipe. They start from a given scene, which may be a measured or a
    predicted scene.

    Args:
        among: names of the allowed grasps; empty for all.
    """
    supports = tuple(neighbors(scene, item))
    height = float(scene.object(item).T_world_object.translation[2])
    stages = grasp_stages(
        ChooseGrasp(item, gripper, s.near, s.approach_distance, excluded, WIDER if ahead else 1, among,
                    _grasp_filter(ahead)),
        gripper, s,
        Close(item, gripper, supports, s.grasp_settle),
        MoveStraight("lift", gripper.arm_group, gripper.tcp_link, s.near, (0.0, 0.0, s.lift_distance),
                 allow=((item, supports),), least=s.least_approach),
        LiftCheck(item, gripper, supports, height),
    )  # fmt: skip
    if ahead:
        after = partial(_grasped, item, gripper)
        stages.insert(1, Lookahead(AHEAD, tuple(ahead), after, ahead=(holding_condition(item),)))
    return stages


def _grasp_filter(ahead: Sequence[Stage]) -> GraspFilter | None:
    """Return a fast test with which a pick rejects grasps that do not allow any placement of the object.

    The test does not consider the arm.
    """
    for stage in ahead:
        if isinstance(stage, ChoosePlacement):
            return lambda scene: stage.why_not(scene, Lookahead.candidates)
    return None


def _grasped(item: str, gripper: Gripper, solution: PartialSolution) -> PartialSolution:
    """Return the solution of a pick in which the object is attached to the hand at the chosen grasp."""
    scene = solution.data["after_approach"].with_attached(item, gripper.tcp_link, gripper.hand_links)
    return solution.then(scene=scene)


def grasp(ctx: TaskContext, item: str, gripper: Gripper) -> Outcome:
    """Grasp an object as in a pick but do not lift it. Contact between object and support stays allowed.

    Raises:
        InputError: no such object, not movable, or the gripper already holds something.
    """
    check_pickable(ctx, item, gripper)
    rest_object(ctx, item)
    s, scene = ctx.settings, ctx.scene()
    supports = tuple(neighbors(scene, item))
    stages = grasp_stages(
        ChooseGrasp(item, gripper, s.near, s.approach_distance), gripper, s,
        Close(item, gripper, supports, s.grasp_settle),
    )  # fmt: skip
    solution, outcome = plan_stages(ctx, stages, f"grasp {item}")
    if solution is None:
        return outcome
    outcome = perform_all(ctx, solution.steps)
    if outcome.ok and supports:
        ctx.change_scene(lambda scene: scene.with_allowed(item, supports))
    return outcome


# --- leaving an object ---
def retreat(item: str, gripper: Gripper, s: TaskSettings, distance: float) -> MoveStraight:
    """Return the stage of a pick that retreats straight,
    against the hand's approach direction, by a distance [m].

    Contact of the hand with the object is allowed during the retreat.
    """
    return MoveStraight(
        "retreat", gripper.arm_group, gripper.tcp_link, s.near, (0.0, 0.0, -distance),
        in_tip_frame=True, allow=((item, gripper.hand_links),), least=s.least_approach,
    )  # fmt: skip


def is_near(scene: PlanningScene, item: str, gripper: Gripper, s: TaskSettings) -> bool:
    """Return whether an open hand may still surround the object after a failed pick."""
    known = scene.object(item)
    low, high = known.bounds()
    at = known.T_world_object.inverse().apply(scene.frame_pose(gripper.tcp_link).translation)
    return bool(np.linalg.norm(at - np.clip(at, low, high)) < s.least_approach)


def retreats(
    scene: PlanningScene, item: str, gripper: Gripper, planning: SearchState
) -> Iterator[PartialSolution]:
    """Yield the retreat that moves an open hand as far as possible from the object that it failed to pick.

    Planners find no path from the start of this retreat; the next plan starts at its end.
    """
    s = planning.settings
    yield from retreat(item, gripper, s, s.approach_distance).propose(PartialSolution(scene), planning)


def back_off(ctx: TaskContext, item: str, gripper: Gripper) -> None:
    """Move the open hand straight back from the object after a failed pick."""
    for solution in retreats(ctx.scene(), item, gripper, SearchState(ctx.settings, ctx.seed, ctx.cancel)):
        perform_all(ctx, solution.steps)
