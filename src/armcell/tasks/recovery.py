"""From one place to another in spite of what goes wrong: look again, pick again, or say why not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from armcell.control import CHANGED
from armcell.core import ErrorCode, InputError, Outcome
from armcell.core.checks import checked, require
from armcell.grasping import Placement
from armcell.model import Gripper
from armcell.tasks.context import TaskContext
from armcell.tasks.interleaved import changed
from armcell.tasks.laying import lay_down
from armcell.tasks.recipes import AHEAD, Vector, back_off, pick, place
from armcell.tasks.stages import ChoosePlacement

GIVEN_UP = "given up"
NO_WAY = (ErrorCode.PLANNING_FAILED, ErrorCode.TIMED_OUT)
CURE = "another place or support for it, a wider gripper, or another arm: `hand_over`"
AGAIN = 2  # times as many lay-downs as are planned in a row, since things come to lie otherwise than planned

Look = Callable[[], Outcome]
"""Looks for the objects and tells the planning scene; an outcome that failed says why."""


@dataclass(frozen=True)
@checked()
class RecoverySettings:
    """How long to go on."""

    tries: int = 5  # picks of one object
    seconds: float = 300.0  # of the driver's clock
    tolerance: float = 0.01  # [m] between where it lies and where it should
    tilt: float = 0.15  # [rad] of turn, besides that about the vertical
    settle: float = 1.0  # [s] until what was dropped lies still
    lay_downs: int = 2  # in between, in a row, where no single grasp does it; 0: never

    def __post_init__(self) -> None:
        require(self.tries >= 1, f"tries is {self.tries}, it must be at least 1")
        require(self.lay_downs >= 0, f"lay_downs is {self.lay_downs}, it must not be negative")
        for name in ("seconds", "tolerance", "tilt", "settle"):
            require(getattr(self, name) > 0, f"{name} is {getattr(self, name):g}, it must be positive")


@dataclass
class Trouble:
    """What went wrong on the way, in order."""

    texts: list[str] = field(default_factory=list)
    laid: list[str] = field(default_factory=list)  # on what it was laid down in between

    def ended(self, outcome: Outcome) -> Outcome:
        evidence = {
            "tries": len(self.texts) + (not outcome.message.startswith(GIVEN_UP)),
            "troubles": list(self.texts),
            "laid_down": list(self.laid),
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
    """Pick an object and put it somewhere, until it lies there.

    What is dropped is found again where it is measured, or seen by `look`, and picked up. What lies elsewhere
    than planned is picked up again. What comes across a motion is planned around. Grasps are chosen so that
    the place can be reached with them. Where no single grasp does that, it is laid down in between and taken
    otherwise (`laying.lay_down`).

    Args:
        on, at: the support and the point on it [m], as for `place`.
        up: direction in the object's frame that shall be up; without it, it stands as it does now.
        look: called before every pick, where poses come from a camera.
    Returns:
        SUCCESS, or why it was given up. Evidence: `tries`, `troubles` (what went wrong), `laid_down` (on what
        in between).
    Raises:
        InputError: no such object or support.
    """
    require(item != on, f"{item!r} cannot be put on itself")
    s, trouble = settings, Trouble()
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
        if outcome.code is CHANGED:
            continue
        stayed = not changed(before, ctx.scene())
        ctx.advance(s.settle)
        if outcome.code in NO_WAY and look is None and stayed and not changed(before, ctx.scene()):
            text = f"{GIVEN_UP}, for nothing has moved meanwhile: {outcome.message}"
            return trouble.ended(replace(outcome, message=text))
        if item not in ctx.holding and not stayed:
            back_off(ctx, item, gripper)
    text = f"{GIVEN_UP} after {s.tries} tries, the last: {outcome.message}"
    return trouble.ended(replace(outcome, message=text))


def _once(
    ctx: TaskContext, item: str, gripper: Gripper, on: str, at: tuple[float, float] | None,
    up: Vector | None, look: Look | None, s: RecoverySettings, trouble: Trouble,
) -> Outcome:  # fmt: skip
    """One way from wherever the object is to its place, with lay-downs in between where it needs them."""
    for left in reversed(range(AGAIN * s.lay_downs + 1)):
        if item not in ctx.holding and look is not None:
            seen = look()
            if item not in ctx.scene().objects:
                return seen if not seen.ok else Outcome(ErrorCode.FAILURE, f"{item} is not seen")
        outcome = _straight(ctx, item, gripper, on, at, up)
        if outcome.code not in NO_WAY:
            return _landed(ctx, item, outcome, s) if outcome.ok else outcome
        if left == 0 or _one_would_do(outcome):
            break
        laid = lay_down(ctx, item, gripper, on, at, up, s.lay_downs)
        if laid.code in NO_WAY:
            text = f"{outcome.message}; {laid.message} ({CURE})"
            outcome = replace(outcome, message=text, evidence={**outcome.evidence, "lay_down": laid.evidence})
            break
        laid = _landed(ctx, item, laid, s) if laid.ok else laid
        if not laid.ok:
            return laid
        trouble.laid.append(str(laid.evidence["laid_on"]))
    if up is None and item not in ctx.holding:  # another place may turn up later
        outcome = pick(ctx, item, gripper)
        outcome = _placed(ctx, item, on, at, up) if outcome.ok else outcome
    return _landed(ctx, item, outcome, s) if outcome.ok else outcome


def _one_would_do(outcome: Outcome) -> bool:
    """Whether some grasp leads to the goal, and it is the motion to it that was not found."""
    return any(row["stage"] == AHEAD and row["passed"] for row in outcome.evidence.get("stages", ()))


def _straight(
    ctx: TaskContext, item: str, gripper: Gripper, on: str, at: tuple[float, float] | None, up: Vector | None
) -> Outcome:
    """With one grasp, if there is one with which the place can be reached."""
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
    except InputError as error:  # it does not fit as it is held now
        return Outcome(ErrorCode.PLANNING_FAILED, str(error))


def _goal(
    ctx: TaskContext, item: str, gripper: Gripper, on: str, at: tuple[float, float] | None, up: Vector | None
) -> ChoosePlacement:
    return ChoosePlacement(item, on, gripper, ctx.settings.near, ctx.settings.lower_distance, at, up)


def _landed(ctx: TaskContext, item: str, outcome: Outcome, s: RecoverySettings) -> Outcome:
    """Does it lie where it was put?"""
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
