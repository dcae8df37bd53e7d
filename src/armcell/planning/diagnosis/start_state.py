"""Diagnosis of an invalid start of a motion.

The start is outside joint limits, in collision, or different from the measured state.
"""

from __future__ import annotations

import numpy as np

from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.resting_contact import RESTING, resting_contacts
from armcell.core import ErrorCode, Explanation, JointState, PlanRequest, Suggestion
from armcell.planning.diagnosis import text_format
from armcell.planning.diagnosis.changes import (
    SceneAndRequest,
    allow_contact,
    change_request,
    change_start,
    reset_state,
)
from armcell.planning.diagnosis.contacts import pairs_of, suggest_freeing_objects
from armcell.planning.diagnosis.diagnosis import Diagnosis, report_distance, report_limit_margins
from armcell.scene import PlanningScene

WITHIN = 1e-6  # [rad or m] inside a limit


def explain_start_limits(diagnosis: Diagnosis) -> None:
    """Diagnose start positions of joints that are outside their limits or not finite, and suggest valid
    positions.
    """
    model, q = diagnosis.scene.model, diagnosis.start_scene.positions
    wrong, mended = {}, {}
    usual = model.default_positions()
    for k, (name, value) in enumerate(zip(model.joint_names, q, strict=True)):
        limits = model.joints[name].limits
        if not np.isfinite(value):
            diagnosis.add_finding(f"{name} is not a number")
            wrong[name], mended[name] = None, float(usual[k])
        elif not limits.lower <= value <= limits.upper:
            beyond = max(limits.lower - value, value - limits.upper)
            side = "below" if value < limits.lower else "above"
            side = f"{text_format.joint_value(model, name, beyond)} {side}"
            low, high = (text_format.joint_value(model, name, v) for v in (limits.lower, limits.upper))
            diagnosis.add_finding(f"{name} is {side} its limits ({low} to {high})")
            wrong[name] = beyond
            mended[name] = float(np.clip(value, limits.lower + WITHIN, limits.upper - WITHIN))
    diagnosis.data["joints_outside"] = wrong
    if not mended:
        return
    state = JointState.from_mapping(mended)
    text = ", ".join(f"{n} at {text_format.joint_value(model, n, v)}" for n, v in mended.items())
    given = diagnosis.request.start
    in_scene = given is None or any(name not in given.joint_names for name in mended)
    change = reset_state if in_scene else change_start
    diagnosis.suggest(f"start with {text}", change, {"state": state})
    home = JointState(model.joint_names, usual)
    diagnosis.suggest("start from the robot's home state", change, {"state": home}, effort=np.inf)


def explain_start_contact(diagnosis: Diagnosis) -> None:
    """Diagnose contacts in the start state, and suggest a contact-free start, moved objects or an allowed
    contact.
    """
    checker = KernelChecker(diagnosis.start_scene, diagnosis.joint_names)
    contacts = checker.exact.contacts(diagnosis.start, padded=False) or resting_contacts(
        checker, diagnosis.start
    )
    diagnosis.contacts, diagnosis.state = contacts, diagnosis.group_state(diagnosis.start)
    for contact in contacts:
        diagnosis.add_finding(contact.describe())
    _report_departure(diagnosis)
    report_limit_margins(diagnosis)
    q = diagnosis.nearest_free(diagnosis.start)
    if q is not None:
        diagnosis.nearest = diagnosis.group_state(q)
        step = text_format.joint_steps(diagnosis.scene.model, diagnosis.joint_names, q - diagnosis.start)
        apart = float(np.linalg.norm(q - diagnosis.start))
        diagnosis.data["nearest_free_start_rad"] = apart
        report_distance(diagnosis, "the nearest free configuration", diagnosis.start, q)
        diagnosis.suggest(
            f"start {step} from here (the nearest free configuration)",
            change_start,
            {"state": diagnosis.nearest},
            effort=apart,
        )
    suggest_freeing_objects(diagnosis, [diagnosis.start], contacts, padded=False)
    held = diagnosis.scene.attached
    for a, b in pairs_of(contacts):
        if a in held or b in held:
            item, other = (a, b) if a in held else (b, a)
            diagnosis.suggest(
                f"allow contact between {item}, which is held, and {other}, if that is meant",
                allow_contact,
                {"a": item, "b": other},
                effort=np.inf,
            )


def _report_departure(diagnosis: Diagnosis) -> None:
    """Report why the planner cannot move the robot out of the contacts in its start state."""
    deepest = max((-c.distance for c in diagnosis.contacts), default=0.0)
    if deepest > RESTING:
        diagnosis.add_finding(
            f"a motion leads out of contacts up to {text_format.length(RESTING)} deep by itself, "
            f"this one is {text_format.length(deepest)} deep"
        )
    elif diagnosis.result.evidence.get("no_departure"):
        blocked = diagnosis.result.evidence.get("blocked_by", [])
        where = f": on the nearest way out, {text_format.contacts(blocked)}" if blocked else ""
        diagnosis.add_finding(f"no motion of {diagnosis.request.group} leads out of this contact{where}")


ALIKE = 0.02  # [rad] largest difference of equal positions


def explain_start(measured: JointState, planned: JointState, tolerance: float, code: ErrorCode,
                  message: str, seconds: float = 0.0) -> Explanation:  # fmt: skip
    """Explain which measured joints differ from a motion's start state and by how much, and what to do about
    it.

    Args:
        planned: start of the motion. measured: state of the robot, with the same joints.
        tolerance: largest difference [rad or m] at which the motion may begin.
        seconds: not used; this explanation needs no search.
    """
    off = measured.reindexed(planned.joint_names).positions - planned.positions
    order = np.argsort(-np.abs(off))
    names = [planned.joint_names[k] for k in order if abs(off[k]) > tolerance]
    details = [
        f"{planned.joint_names[k]} is at {measured[planned.joint_names[k]]:.4f}, the motion starts at "
        f"{planned.positions[k]:.4f}: {off[k]:+.4f} off"
        for k in order
        if abs(off[k]) > tolerance
    ]
    turns = np.round(off / (2 * np.pi))
    if turns.any() and np.all(np.abs(off - 2 * np.pi * turns) <= max(tolerance, ALIKE)):
        details.append("the difference is whole turns: driver and planner count turns differently")
    elif _looks_like_degrees(measured, planned):
        details.append("the measured positions look like degrees where radians are wanted")
    text = "plan again from where the robot is"
    state = measured.reindexed(planned.joint_names)
    return Explanation(
        code,
        message,
        tuple(details),
        (Suggestion(text, start_from, {"state": state}, float(np.abs(off).max(initial=0.0))),),
        state=state,
        nearest=planned,
        data={"joints": names, "off": dict(zip(planned.joint_names, off.tolist(), strict=True))},
    )


def start_from(scene: PlanningScene, request: PlanRequest, state: JointState) -> SceneAndRequest:
    """Repair the start state of a request, as a diagnosis suggests: set the scene's robot state to the
    measured state, and remove the invalid start from the request.
    """
    return change_request(scene.with_state(state), request, start=None)


def _looks_like_degrees(measured: JointState, planned: JointState) -> bool:
    values = measured.reindexed(planned.joint_names).positions
    return bool(np.abs(values).max(initial=0.0) > 2 * np.pi and np.allclose(
        np.deg2rad(values), planned.positions, atol=ALIKE
    ))  # fmt: skip
