"""A goal that is out of limits, in collision or out of reach."""

from __future__ import annotations

import time

import numpy as np

from armcell.collision import ExactChecker
from armcell.core import ConstraintGoal, InputError, JointGoal, JointState, NamedGoal, PlanRequest, PoseGoal
from armcell.planning.explanation import words
from armcell.planning.explanation.case import Case, tell_margins, tell_way
from armcell.planning.explanation.changes import allow_contact, change_goal, change_padding
from armcell.planning.explanation.constraints import goal_too_constrained
from armcell.planning.explanation.contacts import free_objects, pairs_of
from armcell.planning.explanation.nearest import PoseSearch
from armcell.planning.explanation.pose import Branch, explain_pose

MOST_GOALS = 3  # that are looked into
MOST_TOLD = 4  # joint solutions in words
SHARE = 0.4  # of the time left goes to the search for a nearer pose


def goals(case: Case) -> None:
    """Each goal in turn."""
    request = case.request
    assert isinstance(request, PlanRequest)
    tell_margins(case)
    if not request.goals:
        _no_goal(case)
    for number, goal in enumerate(request.goals[:MOST_GOALS]):
        if isinstance(goal, PoseGoal):
            _pose(case, number, goal)
        elif isinstance(goal, JointGoal | NamedGoal):
            _joints(case, number, goal)
        elif isinstance(goal, ConstraintGoal):
            goal_too_constrained(case, number, goal)


def _no_goal(case: Case) -> None:
    """Somewhere to go that is known to the group."""
    model = case.scene.model
    states = model.named_states.get(case.request.group, {})
    case.say(f"named states of {case.request.group}: {', '.join(sorted(states)) or 'none'}")
    for name in sorted(states, key=lambda n: n != "home")[:3]:
        case.suggest(
            f"give a goal, say the named state {name!r}", change_goal, {"number": 0, "goal": NamedGoal(name)}
        )


def wanted_joints(case: Case, goal: JointGoal | NamedGoal) -> np.ndarray | None:
    """(n,) of the group that a goal asks for, in limits or not; None where it is misuse."""
    model = case.scene.model
    try:
        state = (
            model.named_state(case.request.group, goal.name) if isinstance(goal, NamedGoal) else goal.state
        )
        return case.started.state.updated(state).reindexed(case.joint_names).positions
    except InputError:
        return None


def _joints(case: Case, number: int, goal: JointGoal | NamedGoal) -> None:
    q = wanted_joints(case, goal)
    if q is None:
        return
    model, names, columns = case.scene.model, case.joint_names, case.columns
    lower, upper = model.lower[columns], model.upper[columns]
    over = np.maximum(np.maximum(lower - q, q - upper), 0.0)
    turned, within = q.copy(), np.clip(q, lower, upper)
    for k in np.flatnonzero(over > 1e-9):
        name = names[k]
        low, high = (words.joint_value(model, name, v) for v in (lower[k], upper[k]))
        side = "below" if q[k] < lower[k] else "above"
        case.say(f"{name} is {words.joint_value(model, name, over[k])} {side} its limits ({low} to {high})")
        whole = q[k] + 2 * np.pi * np.arange(-2, 3)
        fitting = whole[(whole >= lower[k]) & (whole <= upper[k])]
        if len(fitting) and model.joint(name).type != "prismatic":
            turned[k] = fitting[np.argmin(np.abs(fitting - case.start[k]))]
        else:
            turned[k] = within[k]
    if np.any(over > 1e-9):
        case.data["goal_joints_outside"] = {names[k]: float(over[k]) for k in np.flatnonzero(over > 1e-9)}
        same = np.allclose(np.remainder(turned - q + np.pi, 2 * np.pi), np.pi)
        for at, what in ((turned, "the same place by whole turns" if same else "at the limit"),
                         (within, "at the limit")):  # fmt: skip
            if case.checker.is_free(at):
                _suggest_joints(case, number, q, at, what)
                break
    else:
        _contacts_at(case, q)
    near = None if case.suggestions else case.nearest_free(within)
    if near is not None and not np.allclose(near, q):
        tell_way(case, "the nearest free configuration", q, near)
        _suggest_joints(case, number, q, near, "the nearest free configuration")
    if not np.any(over > 1e-9):
        _other_ways(case, q)


def _suggest_joints(case: Case, number: int, q: np.ndarray, at: np.ndarray, what: str) -> None:
    step = words.joint_steps(case.scene.model, case.joint_names, at - q)
    apart = float(np.linalg.norm(at - q))
    case.data.setdefault("nearest_goal_rad", apart)
    goal = JointGoal(JointState(case.joint_names, at))
    if case.suggest(
        f"change the goal: {step} ({what})", change_goal, {"number": number, "goal": goal}, effort=apart
    ):
        case.nearest = case.nearest or case.group_state(at)


def _contacts_at(case: Case, q: np.ndarray) -> None:
    if case.checker.is_free(q):
        return
    contacts = case.checker.exact.contacts(q)
    for contact in contacts:
        case.say(f"at the goal {contact.describe()}")
    if not case.contacts:
        case.contacts, case.state = contacts, case.group_state(q)


def _other_ways(case: Case, q: np.ndarray) -> None:
    """What else would make a goal configuration (n,) free: a smaller padding, objects moved."""
    contacts = ExactChecker(case.started, case.joint_names).contacts(q)
    if not contacts:
        return
    _less_padding(case, contacts)
    free_objects(case, [q, case.start], contacts, padded=True)
    held = case.scene.attached
    for a, b in pairs_of(contacts):
        if (a in held) != (b in held):
            item, other = (a, b) if a in held else (b, a)
            case.suggest(
                f"allow contact between {item}, which is held, and {other}, if that is meant",
                allow_contact,
                {"a": item, "b": other},
                effort=np.inf,
            )


def _less_padding(case: Case, contacts: list) -> None:
    least = min(c.distance for c in contacts)
    if least <= 0:
        return
    case.say(
        "nothing touches: it is the padding that forbids it "
        f"(the nearest pair is {words.length(least)} apart)"
    )
    fitting = np.floor(least * 0.98e4) / 1e4  # a tenth of a millimetre
    case.suggest(
        f"reduce the padding to {words.length(fitting)}", change_padding, {"padding": float(fitting)}
    )


def _pose(case: Case, number: int, goal: PoseGoal) -> None:
    request = case.request
    found = explain_pose(case.started, request.group, goal.T_world_link, goal.link)
    _tell_branches(case, found)
    until = time.monotonic() + SHARE * max(case.time_left, 0.0)
    search = PoseSearch(case.started, request.group, goal.link, case.checker.is_free, 0, until)
    T = goal.T_world_link
    if found.branches and not found.reachable:
        if not case.contacts:
            case.contacts = found.branches[0].contacts
            case.state = case.group_state(found.branches[0].positions)
        near = search.nearest_position(T)
    elif not found.branches and found.closest is not None:
        near = _back_into_reach(case, search, T, found.closest)
    else:
        near = None  # it can be reached: what fails is the way there
    if not found.reachable:
        turned = search.nearest_orientation(T)
        shifted = _tell_shift(case, number, goal, near)
        rotated = _tell_turn(case, number, goal, turned)
        if not (shifted or rotated) and found.closest is not None:
            _closest_pose(case, number, goal, search, found.closest)
        if found.branches:
            _other_ways(case, found.branches[0].positions)


def _tell_branches(case: Case, found) -> None:
    model = case.scene.model
    if found.distance is not None and found.reach is not None:
        case.data["distance_m"], case.data["reach_m"] = found.distance, found.reach
        if found.distance > found.reach:
            case.say(
                f"the pose is {words.length(found.distance)} from the first joint, "
                f"{words.length(found.distance - found.reach)} beyond the arm's reach"
            )
    _tell_some(case, "joint solution", found.branches)
    if not found.branches:
        _tell_some(case, "joint solution outside limits", found.outside)
    elif found.outside:
        joints = sorted({name for b in found.outside for name in b.beyond})
        case.say(f"{len(found.outside)} more joint solutions are outside the limits of {', '.join(joints)}")
    case.data.setdefault("branches", []).extend(
        {
            "positions": b.positions,
            "reason": b.reason(model),
            "contacts": b.contacts,
            "beyond_limits": dict(b.beyond),
        }
        for b in (*found.branches, *found.outside)
    )


def _tell_some(case: Case, what: str, branches: list[Branch]) -> None:
    """The first few; the data has them all."""
    for count, branch in enumerate(branches[:MOST_TOLD], 1):
        joints = " ".join(f"{v:.0f}" for v in np.rad2deg(branch.positions))
        case.say(f"{what} {count} ({joints} deg): {branch.reason(case.scene.model)}")
    if rest := branches[MOST_TOLD:]:
        bodies = {n for b in rest for c in b.contacts for n in (c.body_a, c.body_b)}
        joints = {n for b in rest for n in b.beyond}
        free = sum(b.free for b in rest)
        why = f"{free} of them free" if free else f"with {', '.join(sorted(bodies | joints))}"
        case.say(f"{len(rest)} more, {why}")


def _back_into_reach(case: Case, search: PoseSearch, T, closest):
    """The wanted orientation, as near as it gets on lines to the closest pose, to the tip and the base."""
    at = case.started.positions.copy()
    at[case.columns] = closest
    tree, tip = search.ik.tree, search.ik.tip_link
    first = case.scene.model.joint(case.joint_names[0]).child
    points = [
        tree.link_pose(at, tip).translation,
        tree.link_pose(case.started.positions, tip).translation,
        tree.link_pose(case.started.positions, first).translation,
    ]
    return search.towards(T, points)


def _tell_shift(case: Case, number: int, goal: PoseGoal, near) -> bool:
    if near is None:
        return False
    pose, q = near
    step = pose.translation - goal.T_world_link.translation
    apart = float(np.linalg.norm(step))
    case.data.setdefault("nearest_pose", pose)
    case.data.setdefault("nearest_goal_m", apart)
    return _suggest_pose(case, number, goal, pose, q, f"move the goal {words.offset(step)}", apart)


def _tell_turn(case: Case, number: int, goal: PoseGoal, near) -> bool:
    if near is None:
        return False
    pose, q = near
    turn = (goal.T_world_link.rotation.inv() @ pose.rotation).log()
    case.data.setdefault("nearest_turn_rad", float(np.linalg.norm(turn)))
    return _suggest_pose(
        case, number, goal, pose, q, f"turn the goal {words.turn(turn)}", float(np.linalg.norm(turn))
    )


def _closest_pose(case: Case, number: int, goal: PoseGoal, search: PoseSearch, closest) -> None:
    """Position and orientation both changed: where the arm comes closest."""
    at = case.started.positions.copy()
    at[case.columns] = closest
    pose = search.ik.tree.link_pose(at, search.ik.tip_link)
    q = search.reached(pose)
    if q is None:
        return
    step, turn = goal.T_world_link.distance_to(pose)
    text = f"take the closest pose there is: {words.length(step)} and {words.angle(turn)} away"
    _suggest_pose(case, number, goal, pose, q, text, step + turn)


def _suggest_pose(case: Case, number: int, goal: PoseGoal, pose, q, text: str, effort: float) -> bool:
    changed = PoseGoal(pose, goal.link, goal.position_tolerance, goal.orientation_tolerance)
    if not case.suggest(text, change_goal, {"number": number, "goal": changed}, effort=effort):
        return False
    case.nearest = case.nearest or case.group_state(q)
    return True
