"""Transfer of an object to its goal, with recovery from failures.

Recovery looks again, picks again, or reports why it gives up.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from armcell.core import ErrorCode, InputError, Outcome
from armcell.core.checks import checked, require
from armcell.execution import SCENE_INVALIDATED
from armcell.grasping import Placement
from armcell.model import Gripper
from armcell.tasks.context import TaskContext
from armcell.tasks.intermediate_placement import place_intermediate
from armcell.tasks.pick import AHEAD, back_off, pick
from armcell.tasks.pipelined import scene_difference
from armcell.tasks.recipes import Vector, place
from armcell.tasks.stages import ChoosePlacement

GIVEN_UP = "given up"
NO_WAY = (ErrorCode.PLANNING_FAILED, ErrorCode.TIMED_OUT)
HINT = "another place or support for it, a wider gripper, or another arm: `hand_over`"
AGAIN = 2  # factor on the planned intermediate placements, because objects may settle differently

Look = Callable[[], Outcome]
"""Looks for the objects and updates the planning scene; a failed outcome states the reason."""


@dataclass(frozen=True)
@checked()
class RecoverySettings:
    """Limits for recovery from failures during a transfer,
    and tolerances within which the transfer counts as a success.
    """

    tries: int = 5  # picks of one object
    seconds: float = 300.0  # time limit [s] on the driver's clock
    tolerance: float = 0.01  # [m] position error of the placed object
    tilt: float = 0.15  # [rad] tilt; rotation about the vertical does not count
    settle: float = 1.0  # [s] until a dropped object rests
    intermediate_placements: int = 2  # in a row, if no single grasp suffices; 0: never

    def __post_init__(self) -> None:
        require(self.tries >= 1, f"tries is {self.tries}, it must be at least 1")
        require(
            self.intermediate_placements >= 0,
            f"intermediate_placements is {self.intermediate_placements}, it must not be negative",
        )
        for name in ("seconds", "tolerance", "tilt", "settle"):
            require(getattr(self, name) > 0, f"{name} is {getattr(self, name):g}, it must be positive")


@dataclass
class TransferFailures:
    """Failures during the transfer of an object with recovery, in the order in which they occurred."""

    texts: list[str] = field(default_factory=list)
    laid: list[str] = field(default_factory=list)  # supports of the intermediate placements

    def ended(self, outcome: Outcome) -> Outcome:
        evidence = {
            "tries": len(self.texts) + (not outcome.message.startswith(GIVEN_UP)),
            "troubles": list(self.texts),
            "intermediate_placements": list(self.laid),
        }
        return replace(outcome, evidence={**outcome.evidence, **evidence})


def transfer(
    ctx: TaskContext,
    item: str,
    gripper: Gripper,
    on: str,
    at: tuple[float, float] | None = None,
    up: Vector | None = None,
    look: Look | None = None,
    settings: RecoverySettings = RecoverySettings(),
) -> Outcome:
    """Transfer an object to its goal by pick and place, and recover from failures until it is there.

    A dropped or inaccurately placed object is picked up again from its measured pose, or from the pose that
    `look` finds. A blocked motion is planned again around the obstacle. Only grasps with which the arm can
    place the object at the goal are used. If there are none, the arm first puts the object down at an
    intermediate placement (`intermediate_placement.py`).

    Args:
        on, at: the support and the point on it [m], as for `place`.
        up: direction in the object's frame that must point up; default: keep the present side up.
        look: called before every pick if poses come from a camera.
    Returns:
        SUCCESS, or the last failure. Evidence: `tries`, `troubles` (all failures), `intermediate_placements`
        (their supports).
    Raises:
        InputError: no such object or support.
    """
    require(item != on, f"{item!r} cannot be put on itself")
    s, trouble = settings, TransferFailures()
    began = ctx.driver.now
    outcome = Outcome(ErrorCode.FAILURE, "not tried")
    while len(trouble.texts) < s.tries:
        if ctx.driver.now - began > s.seconds:
            text = f"{GIVEN_UP} after {s.seconds:.0f} s: {outcome.message}"
            return trouble.ended(replace(outcome, message=text))
        before = ctx.scene()
        outcome = _once(ctx, item, gripper, on, at, up, look, s, trouble)
        if outcome.ok or outcome.code is ErrorCode.PREEMPTED:
            return trouble.ended(outcome)
        trouble.texts.append(outcome.message)
        ctx.emit("note", f"transfer {item}: {outcome.message}; trying again")
        if outcome.code is SCENE_INVALIDATED:
            continue
        stayed = not scene_difference(before, ctx.scene())
        ctx.advance(s.settle)
        if outcome.code in NO_WAY and look is None and stayed and not scene_difference(before, ctx.scene()):
            text = f"{GIVEN_UP}, because no object has moved since the last try: {outcome.message}"
            return trouble.ended(replace(outcome, message=text))
        if item not in ctx.holding and not stayed:
            back_off(ctx, item, gripper)
    text = f"{GIVEN_UP} after {s.tries} tries, the last: {outcome.message}"
    return trouble.ended(replace(outcome, message=text))


def _once(
    ctx: TaskContext, item: str, gripper: Gripper, on: str, at: tuple[float, float] | None,
    up: Vector | None, look: Look | None, s: RecoverySettings, trouble: TransferFailures,
) -> Outcome:  # fmt: skip
    """Attempt once to transfer an object, with intermediate placements if needed.
    Recovery repeats such attempts.
    """
    for left in reversed(range(AGAIN * s.intermediate_placements + 1)):
        if item not in ctx.holding and look is not None:
            seen = look()
            if item not in ctx.scene().objects:
                return seen if not seen.ok else Outcome(ErrorCode.FAILURE, f"{item} is not seen")
        outcome = _straight(ctx, item, gripper, on, at, up)
        if outcome.code not in NO_WAY:
            return _landed(ctx, item, outcome, s) if outcome.ok else outcome
        if left == 0 or _one_would_do(outcome):
            break
        laid = place_intermediate(ctx, item, gripper, on, at, up, s.intermediate_placements)
        if laid.code in NO_WAY:
            text = f"{outcome.message}; {laid.message} ({HINT})"
            outcome = replace(
                outcome, message=text, evidence={**outcome.evidence, "intermediate_placement": laid.evidence}
            )
            break
        laid = _landed(ctx, item, laid, s) if laid.ok else laid
        if not laid.ok:
            return laid
        trouble.laid.append(str(laid.evidence["support"]))
    if up is None and item not in ctx.holding:  # another placement may be possible later
        outcome = pick(ctx, item, gripper)
        outcome = _placed(ctx, item, on, at, up) if outcome.ok else outcome
    return _landed(ctx, item, outcome, s) if outcome.ok else outcome


def _one_would_do(outcome: Outcome) -> bool:
    """Return whether a failed object transfer found a grasp with which the object can be placed at the goal.
    If so, recovery does not regrasp the object.
    """
    return any(row["stage"] == AHEAD and row["passed"] for row in outcome.evidence.get("stages", ()))


def _straight(
    ctx: TaskContext, item: str, gripper: Gripper, on: str, at: tuple[float, float] | None, up: Vector | None
) -> Outcome:
    """Attempt to transfer an object to its goal directly, with one grasp and no intermediate placement. If
    the attempt fails, recovery follows.

    Only grasps with which the arm can also place the object at the goal are tried. If a hand already holds
    the object, the function only places it. The caller recovers from failures.
    """
    if item not in ctx.holding:
        outcome = pick(ctx, item, gripper, ahead=[_goal(ctx, item, gripper, on, at, up)])
        if not outcome.ok:
            return outcome
    return _placed(ctx, item, on, at, up)


def _placed(
    ctx: TaskContext, item: str, on: str, at: tuple[float, float] | None, up: Vector | None
) -> Outcome:
    try:
        return place(ctx, item, on, at, up)
    except InputError as error:  # it does not fit in its present orientation
        return Outcome(ErrorCode.PLANNING_FAILED, str(error))


def _goal(
    ctx: TaskContext, item: str, gripper: Gripper, on: str, at: tuple[float, float] | None, up: Vector | None
) -> ChoosePlacement:
    return ChoosePlacement(item, on, gripper, ctx.settings.near, ctx.settings.lower_distance, at, up)


def _landed(ctx: TaskContext, item: str, outcome: Outcome, s: RecoverySettings) -> Outcome:
    """Check, for recovery from failures, that a transferred object is within tolerance of its target pose."""
    wanted = outcome.evidence.get("placement")
    if not isinstance(wanted, Placement):
        return outcome
    ctx.advance(s.settle / 2)
    T = ctx.driver.object_poses()[item]
    away = float(np.linalg.norm(T.translation - wanted.T_world_object.translation))
    tilt = float(np.arccos(np.clip(T.rotation.matrix[2] @ wanted.T_world_object.rotation.matrix[2], -1, 1)))
    if away <= s.tolerance and tilt <= s.tilt:
        return replace(outcome, evidence={**outcome.evidence, "error_m": away})
    text = f"{item} lies {away * 1000:.0f} mm and {np.rad2deg(tilt):.0f} deg from where it was put"
    return Outcome(ErrorCode.CONTROL_FAILED, text, outcome.evidence)
