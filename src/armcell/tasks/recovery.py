"""From one place to another in spite of what goes wrong: look again, pick again, or say why not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from armcell.core import ErrorCode, InputError, Outcome
from armcell.core.checks import require
from armcell.grasping import Placement
from armcell.model import Gripper
from armcell.tasks.context import TaskContext
from armcell.tasks.recipes import Vector, back_off, pick, place
from armcell.tasks.stages import ChoosePlacement

GIVEN_UP = "given up"

Look = Callable[[], Outcome]
"""Looks for the objects and tells the planning scene; an outcome that failed says why."""


@dataclass(frozen=True)
class RecoverySettings:
    """How long to go on."""

    tries: int = 5  # picks of one object
    seconds: float = 300.0  # of the driver's clock
    tolerance: float = 0.01  # [m] between where it lies and where it should
    tilt: float = 0.15  # [rad] of turn, besides that about the vertical
    settle: float = 1.0  # [s] until what was dropped lies still

    def __post_init__(self) -> None:
        require(self.tries >= 1, f"tries is {self.tries}, it must be at least 1")
        for name in ("seconds", "tolerance", "tilt", "settle"):
            require(getattr(self, name) > 0, f"{name} is {getattr(self, name):g}, it must be positive")


@dataclass
class Trouble:
    """What went wrong on the way, in order."""

    texts: list[str] = field(default_factory=list)

    def ended(self, outcome: Outcome) -> Outcome:
        evidence = {
            "tries": len(self.texts) + (not outcome.message.startswith(GIVEN_UP)),
            "troubles": list(self.texts),
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
    than planned is picked up again. Grasps are chosen so that the place can be reached with them.

    Args:
        on, at: the support and the point on it [m], as for `place`.
        up: direction in the object's frame that shall be up; without it, it stands as it does now.
        look: called before every pick, where poses come from a camera.
    Returns:
        SUCCESS, or why it was given up. Evidence: `tries`, `troubles` (what went wrong).
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
        outcome = _once(ctx, item, gripper, on, at, up, look, s)
        if outcome.ok or outcome.code is ErrorCode.PREEMPTED:
            return trouble.ended(outcome)
        trouble.texts.append(outcome.message)
        ctx.emit("note", f"transfer {item}: {outcome.message}; trying again")
        ctx.advance(s.settle)
        if item not in ctx.holding:
            back_off(ctx, item, gripper)
    text = f"{GIVEN_UP} after {s.tries} tries, the last: {outcome.message}"
    return trouble.ended(replace(outcome, message=text))


def _once(
    ctx: TaskContext, item: str, gripper: Gripper, on: str, at: tuple[float, float] | None,
    up: Vector | None, look: Look | None, s: RecoverySettings,
) -> Outcome:  # fmt: skip
    """One way from wherever the object is to its place."""
    if item not in ctx.holding:
        if look is not None:
            seen = look()
            if item not in ctx.scene().objects:
                return seen if not seen.ok else Outcome(ErrorCode.FAILURE, f"{item} is not seen")
        goal = _goal(ctx, item, gripper, on, at, up)
        outcome = pick(ctx, item, gripper, ahead=[goal])
        if outcome.code is ErrorCode.PLANNING_FAILED and up is None:  # another place may turn up later
            outcome = pick(ctx, item, gripper)
        if not outcome.ok:
            return outcome
    try:
        outcome = place(ctx, item, on, at, up)
    except InputError as error:  # it does not fit as it is held now
        return Outcome(ErrorCode.PLANNING_FAILED, str(error))
    return _landed(ctx, item, outcome, s) if outcome.ok else outcome


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
