"""A start that is out of limits, not a number, or in collision."""

from __future__ import annotations

import numpy as np

from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.resting import RESTING, touching
from armcell.core import JointState
from armcell.planning.explanation import words
from armcell.planning.explanation.case import Case, tell_margins, tell_way
from armcell.planning.explanation.changes import allow_contact, change_start, reset_state
from armcell.planning.explanation.contacts import free_objects, pairs_of

WITHIN = 1e-6  # [rad or m] inside a limit


def start_invalid(case: Case) -> None:
    """Which joints are outside their limits, or no numbers, and where they would be right."""
    model, q = case.scene.model, case.started.positions
    wrong, mended = {}, {}
    usual = model.default_positions()
    for k, (name, value) in enumerate(zip(model.joint_names, q, strict=True)):
        limits = model.joints[name].limits
        if not np.isfinite(value):
            case.say(f"{name} is not a number")
            wrong[name], mended[name] = None, float(usual[k])
        elif not limits.lower <= value <= limits.upper:
            beyond = max(limits.lower - value, value - limits.upper)
            side = f"{words.joint_value(model, name, beyond)} {'below' if value < limits.lower else 'above'}"
            low, high = (words.joint_value(model, name, v) for v in (limits.lower, limits.upper))
            case.say(f"{name} is {side} its limits ({low} to {high})")
            wrong[name] = beyond
            mended[name] = float(np.clip(value, limits.lower + WITHIN, limits.upper - WITHIN))
    case.data["joints_outside"] = wrong
    if not mended:
        return
    state = JointState.from_mapping(mended)
    told = ", ".join(f"{n} at {words.joint_value(model, n, v)}" for n, v in mended.items())
    given = case.request.start
    in_scene = given is None or any(name not in given.joint_names for name in mended)
    change = reset_state if in_scene else change_start
    case.suggest(f"start with {told}", change, {"state": state})
    home = JointState(model.joint_names, usual)
    case.suggest("start from the robot's home state", change, {"state": home}, effort=np.inf)


def start_in_collision(case: Case) -> None:
    """Which pairs, how deep, what frees them: the arm moved, the object moved, the contact allowed."""
    checker = KernelChecker(case.started, case.joint_names)
    contacts = checker.exact.contacts(case.start, padded=False) or touching(checker, case.start)
    case.contacts, case.state = contacts, case.group_state(case.start)
    for contact in contacts:
        case.say(contact.describe())
    _tell_departure(case)
    tell_margins(case)
    q = case.nearest_free(case.start)
    if q is not None:
        case.nearest = case.group_state(q)
        step = words.joint_steps(case.scene.model, case.joint_names, q - case.start)
        apart = float(np.linalg.norm(q - case.start))
        case.data["nearest_free_start_rad"] = apart
        tell_way(case, "the nearest free configuration", case.start, q)
        case.suggest(
            f"start {step} from here (the nearest free configuration)",
            change_start,
            {"state": case.nearest},
            effort=apart,
        )
    free_objects(case, [case.start], contacts, padded=False)
    held = case.scene.attached
    for a, b in pairs_of(contacts):
        if a in held or b in held:
            item, other = (a, b) if a in held else (b, a)
            case.suggest(
                f"allow contact between {item}, which is held, and {other}, if that is meant",
                allow_contact,
                {"a": item, "b": other},
                effort=np.inf,
            )


def _tell_departure(case: Case) -> None:
    """Why the motion cannot lead out of the contacts by itself, as it does from those where bodies rest."""
    deepest = max((-c.distance for c in case.contacts), default=0.0)
    if deepest > RESTING:
        case.say(
            f"a motion leads out of contacts up to {words.length(RESTING)} deep by itself, "
            f"this one is {words.length(deepest)} deep"
        )
    elif case.result.evidence.get("no_departure"):
        blocked = case.result.evidence.get("blocked_by", [])
        where = f": on the nearest way out, {words.contacts(blocked)}" if blocked else ""
        case.say(f"no motion of {case.request.group} leads out of this contact{where}")
