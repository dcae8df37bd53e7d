"""Diagnosis of a goal that is outside joint limits, in collision or out of reach."""

from __future__ import annotations

import time

import numpy as np

from armcell.collision import ExactChecker
from armcell.core import ConstraintGoal, JointGoal, JointState, NamedGoal, PlanRequest, PoseGoal
from armcell.planning.diagnosis import text_format
from armcell.planning.diagnosis.changes import allow_contact, change_goal, change_padding
from armcell.planning.diagnosis.constraints import diagnose_goal_constraints
from armcell.planning.diagnosis.contacts import pairs_of, suggest_freeing_objects
from armcell.planning.diagnosis.diagnosis import (
    Diagnosis,
    report_distance,
    report_limit_margins,
    wanted_joints,
)
from armcell.planning.diagnosis.nearest_free import PoseSearch
from armcell.planning.diagnosis.unreachable_pose import IKBranch, explain_pose

MAX_GOALS = 3  # goals examined
MAX_REPORTED = 4  # joint solutions reported as text
SHARE = 0.4  # share of the remaining time for the search of a nearby pose


def explain_goals(diagnosis: Diagnosis) -> None:
    """Diagnose the goals of a failed request, one after the other."""
    request = diagnosis.request
    assert isinstance(request, PlanRequest)
    report_limit_margins(diagnosis)
    if not request.goals:
        _no_goal(diagnosis)
    for number, goal in enumerate(request.goals[:MAX_GOALS]):
        if isinstance(goal, PoseGoal):
            _pose(diagnosis, number, goal)
        elif isinstance(goal, JointGoal | NamedGoal):
            _joints(diagnosis, number, goal)
        elif isinstance(goal, ConstraintGoal):
            diagnose_goal_constraints(diagnosis, number, goal)


def _no_goal(diagnosis: Diagnosis) -> None:
    """Suggest named states of the planning group as goals if a request contains no goal."""
    model = diagnosis.scene.model
    states = model.named_states.get(diagnosis.request.group, {})
    diagnosis.add_finding(f"named states of {diagnosis.request.group}: {', '.join(sorted(states)) or 'none'}")
    for name in sorted(states, key=lambda n: n != "home")[:3]:
        diagnosis.suggest(
            f"give a goal, say the named state {name!r}", change_goal, {"number": 0, "goal": NamedGoal(name)}
        )


def _joints(diagnosis: Diagnosis, number: int, goal: JointGoal | NamedGoal) -> None:
    q = wanted_joints(diagnosis, goal)
    if q is None:
        return
    model, names, columns = diagnosis.scene.model, diagnosis.joint_names, diagnosis.columns
    lower, upper = model.lower[columns], model.upper[columns]
    over = np.maximum(np.maximum(lower - q, q - upper), 0.0)
    turned, within = q.copy(), np.clip(q, lower, upper)
    for k in np.flatnonzero(over > 1e-9):
        name = names[k]
        low, high = (text_format.joint_value(model, name, v) for v in (lower[k], upper[k]))
        side = "below" if q[k] < lower[k] else "above"
        diagnosis.add_finding(
            f"{name} is {text_format.joint_value(model, name, over[k])} {side} its limits ({low} to {high})"
        )
        whole = q[k] + 2 * np.pi * np.arange(-2, 3)
        fitting = whole[(whole >= lower[k]) & (whole <= upper[k])]
        if len(fitting) and model.joint(name).type != "prismatic":
            turned[k] = fitting[np.argmin(np.abs(fitting - diagnosis.start[k]))]
        else:
            turned[k] = within[k]
    if np.any(over > 1e-9):
        diagnosis.data["goal_joints_outside"] = {
            names[k]: float(over[k]) for k in np.flatnonzero(over > 1e-9)
        }
        same = np.allclose(np.remainder(turned - q + np.pi, 2 * np.pi), np.pi)
        for at, what in ((turned, "the same place by whole turns" if same else "at the limit"),
                         (within, "at the limit")):  # fmt: skip
            if diagnosis.checker.is_free(at):
                _suggest_joints(diagnosis, number, q, at, what)
                break
    else:
        _contacts_at(diagnosis, q)
    near = None if diagnosis.suggestions else diagnosis.nearest_free(within)
    if near is not None and not np.allclose(near, q):
        report_distance(diagnosis, "the nearest free configuration", q, near)
        _suggest_joints(diagnosis, number, q, near, "the nearest free configuration")
    if not np.any(over > 1e-9):
        _other_ways(diagnosis, q)


def _suggest_joints(diagnosis: Diagnosis, number: int, q: np.ndarray, at: np.ndarray, what: str) -> None:
    step = text_format.joint_steps(diagnosis.scene.model, diagnosis.joint_names, at - q)
    apart = float(np.linalg.norm(at - q))
    diagnosis.data.setdefault("nearest_goal_rad", apart)
    goal = JointGoal(JointState(diagnosis.joint_names, at))
    if diagnosis.suggest(
        f"change the goal: {step} ({what})", change_goal, {"number": number, "goal": goal}, effort=apart
    ):
        diagnosis.nearest = diagnosis.nearest or diagnosis.group_state(at)


def _contacts_at(diagnosis: Diagnosis, q: np.ndarray) -> None:
    if diagnosis.checker.is_free(q):
        return
    contacts = diagnosis.checker.exact.contacts(q)
    for contact in contacts:
        diagnosis.add_finding(f"at the goal {contact.describe()}")
    if not diagnosis.contacts:
        diagnosis.contacts, diagnosis.state = contacts, diagnosis.group_state(q)


def _other_ways(diagnosis: Diagnosis, q: np.ndarray) -> None:
    """Suggest further changes that free a goal configuration (n,) from contact, to diagnose the goal.

    The changes are smaller padding, moved objects and allowed contacts.
    """
    contacts = ExactChecker(diagnosis.start_scene, diagnosis.joint_names).contacts(q)
    if not contacts:
        return
    _less_padding(diagnosis, contacts)
    suggest_freeing_objects(diagnosis, [q, diagnosis.start], contacts, padded=True)
    held = diagnosis.scene.attached
    for a, b in pairs_of(contacts):
        if (a in held) != (b in held):
            item, other = (a, b) if a in held else (b, a)
            diagnosis.suggest(
                f"allow contact between {item}, which is held, and {other}, if that is meant",
                allow_contact,
                {"a": item, "b": other},
                effort=np.inf,
            )


def _less_padding(diagnosis: Diagnosis, contacts: list) -> None:
    least = min(c.distance for c in contacts)
    if least <= 0:
        return
    diagnosis.add_finding(
        "nothing touches: it is the padding that forbids it "
        f"(the nearest pair is {text_format.length(least)} apart)"
    )
    fitting = np.floor(least * 0.98e4) / 1e4  # a tenth of a millimeter
    diagnosis.suggest(
        f"reduce the padding to {text_format.length(fitting)}", change_padding, {"padding": float(fitting)}
    )


def _pose(diagnosis: Diagnosis, number: int, goal: PoseGoal) -> None:
    request = diagnosis.request
    found = explain_pose(diagnosis.start_scene, request.group, goal.T_world_link, goal.link)
    _report_branches(diagnosis, found)
    until = time.monotonic() + SHARE * max(diagnosis.time_left, 0.0)
    search = PoseSearch(diagnosis.start_scene, request.group, goal.link, diagnosis.checker.is_free, 0, until)
    T = goal.T_world_link
    if found.branches and not found.reachable:
        if not diagnosis.contacts:
            diagnosis.contacts = found.branches[0].contacts
            diagnosis.state = diagnosis.group_state(found.branches[0].positions)
        near = search.nearest_position(T)
    elif not found.branches and found.closest is not None:
        near = _back_into_reach(diagnosis, search, T, found.closest)
    else:
        near = None  # the pose is reachable: the path fails
    if not found.reachable:
        turned = search.nearest_orientation(T)
        shifted = _report_shift(diagnosis, number, goal, near)
        rotated = _report_turn(diagnosis, number, goal, turned)
        if not (shifted or rotated) and found.closest is not None:
            _closest_pose(diagnosis, number, goal, search, found.closest)
        if found.branches:
            _other_ways(diagnosis, found.branches[0].positions)


def _report_branches(diagnosis: Diagnosis, found) -> None:
    model = diagnosis.scene.model
    if found.distance is not None and found.reach is not None:
        diagnosis.data["distance_m"], diagnosis.data["reach_m"] = found.distance, found.reach
        if found.distance > found.reach:
            diagnosis.add_finding(
                f"the pose is {text_format.length(found.distance)} from the first joint, "
                f"{text_format.length(found.distance - found.reach)} beyond the arm's reach"
            )
    _report_some(diagnosis, "joint solution", found.branches)
    if not found.branches:
        _report_some(diagnosis, "joint solution outside limits", found.outside)
    elif found.outside:
        joints = sorted({name for b in found.outside for name in b.beyond})
        diagnosis.add_finding(
            f"{len(found.outside)} more joint solutions are outside the limits of {', '.join(joints)}"
        )
    diagnosis.data.setdefault("branches", []).extend(
        {
            "positions": b.positions,
            "reason": b.reason(model),
            "contacts": b.contacts,
            "beyond_limits": dict(b.beyond),
        }
        for b in (*found.branches, *found.outside)
    )


def _report_some(diagnosis: Diagnosis, what: str, branches: list[IKBranch]) -> None:
    """Report the first few joint solutions of a goal pose as text; the data of the diagnosis contains all of
    them.
    """
    for count, branch in enumerate(branches[:MAX_REPORTED], 1):
        joints = " ".join(f"{v:.0f}" for v in np.rad2deg(branch.positions))
        diagnosis.add_finding(f"{what} {count} ({joints} deg): {branch.reason(diagnosis.scene.model)}")
    if rest := branches[MAX_REPORTED:]:
        bodies = {n for b in rest for c in b.contacts for n in (c.body_a, c.body_b)}
        joints = {n for b in rest for n in b.beyond}
        free = sum(b.free for b in rest)
        why = f"{free} of them free" if free else f"with {', '.join(sorted(bodies | joints))}"
        diagnosis.add_finding(f"{len(rest)} more, {why}")


def _back_into_reach(diagnosis: Diagnosis, search: PoseSearch, T, closest):
    """Find a goal pose that the robot reaches, with the orientation of an unreachable goal pose and as near
    to it as possible, for the diagnosis of the goal.
    """
    at = diagnosis.start_scene.positions.copy()
    at[diagnosis.columns] = closest
    tree, tip = search.ik.tree, search.ik.tip_link
    first = diagnosis.scene.model.joint(diagnosis.joint_names[0]).child
    points = [
        tree.link_pose(at, tip).translation,
        tree.link_pose(diagnosis.start_scene.positions, tip).translation,
        tree.link_pose(diagnosis.start_scene.positions, first).translation,
    ]
    return search.towards(T, points)


def _report_shift(diagnosis: Diagnosis, number: int, goal: PoseGoal, near) -> bool:
    if near is None:
        return False
    pose, q = near
    step = pose.translation - goal.T_world_link.translation
    apart = float(np.linalg.norm(step))
    diagnosis.data.setdefault("nearest_pose", pose)
    diagnosis.data.setdefault("nearest_goal_m", apart)
    return _suggest_pose(diagnosis, number, goal, pose, q, f"move the goal {text_format.offset(step)}", apart)


def _report_turn(diagnosis: Diagnosis, number: int, goal: PoseGoal, near) -> bool:
    if near is None:
        return False
    pose, q = near
    turn = (goal.T_world_link.rotation.inverse() @ pose.rotation).log()
    diagnosis.data.setdefault("nearest_turn_rad", float(np.linalg.norm(turn)))
    return _suggest_pose(
        diagnosis,
        number,
        goal,
        pose,
        q,
        f"turn the goal {text_format.turn(turn)}",
        float(np.linalg.norm(turn)),
    )


def _closest_pose(diagnosis: Diagnosis, number: int, goal: PoseGoal, search: PoseSearch, closest) -> None:
    """Suggest the closest reachable pose as goal in place of an unreachable goal pose. Its position and its
    orientation may both differ from the old goal.
    """
    at = diagnosis.start_scene.positions.copy()
    at[diagnosis.columns] = closest
    pose = search.ik.tree.link_pose(at, search.ik.tip_link)
    q = search.reached(pose)
    if q is None:
        return
    step, turn = goal.T_world_link.distance_to(pose)
    text = f"take the closest pose there is: {text_format.length(step)} and {text_format.angle(turn)} away"
    _suggest_pose(diagnosis, number, goal, pose, q, text, step + turn)


def _suggest_pose(
    diagnosis: Diagnosis, number: int, goal: PoseGoal, pose, q, text: str, effort: float
) -> bool:
    changed = PoseGoal(pose, goal.link, goal.position_tolerance, goal.orientation_tolerance)
    if not diagnosis.suggest(text, change_goal, {"number": number, "goal": changed}, effort=effort):
        return False
    diagnosis.nearest = diagnosis.nearest or diagnosis.group_state(q)
    return True
