"""Start and goals are fine, but there is no motion between them: too little time, or something in the way."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from armcell.core import ErrorCode, JointGoal, JointState, NamedGoal, PlanRequest, PoseGoal
from armcell.planning.explanation import words
from armcell.planning.explanation.case import TRY, Case, tell_margins
from armcell.planning.explanation.changes import (
    change_goal,
    change_mass,
    change_padding,
    change_request,
    padded,
    remove_objects,
    without,
)
from armcell.planning.explanation.constraints import too_constrained
from armcell.planning.explanation.goal import wanted_joints
from armcell.planning.explanation.nearest import PoseSearch

SHORT = 0.5  # [s] of planning for one "what if"
MOST_PAIRS = 15
ALONG = (0.9, 0.75, 0.5, 0.25)  # of the way from the start to the goal that are tried
DEFAULT = {"planner_id": "RRTConnect", "pipeline_id": "native"}


def no_motion(case: Case) -> None:
    """What a longer time, another planner, a smaller padding or an object less would do."""
    request = case.request
    assert isinstance(request, PlanRequest)
    if case.result.code is ErrorCode.PREEMPTED:
        case.say("it was cancelled: nothing is known to be wrong with it")
        case.suggest("ask again", change_request)
        return
    tell_margins(case)
    evidence = case.result.evidence
    if "torque" in evidence:
        _too_weak(case, evidence["joint"], evidence["torque"], evidence["limit"])
        return
    _tell_search(case)
    if too_constrained(case) or _more_time(case, request) or _other_planner(case, request):
        return
    _less_padding(case, request)
    _in_the_way(case, request)
    _not_so_far(case, request)


def _tell_search(case: Case) -> None:
    """What the planner saw."""
    evidence = case.result.evidence
    blocked = evidence.get("blocked_by", [])
    if "closest_approach_rad" in evidence:
        near = f"; there {words.contacts(blocked)}" if blocked else ""
        case.say(f"the search came within {evidence['closest_approach_rad']:.2f} rad of a path{near}")
        case.data["closest_approach_rad"] = evidence["closest_approach_rad"]
    case.contacts = list(blocked)


def _more_time(case: Case, request: PlanRequest) -> bool:
    """Only where little was given: what five seconds do not find is not a matter of time."""
    if request.planning_time >= TRY:
        return False
    for seconds in (0.1, 0.5, TRY):
        if seconds > request.planning_time:
            result = case.succeeds(case.scene, replace(request, planning_time=seconds), seconds)
            if result is not None:
                case.say(f"with {seconds:g} s a path is found, after {result.planning_time:.3g} s")
                case.suggest(
                    f"give planning_time {seconds:g} s",
                    change_request,
                    {"planning_time": seconds},
                    effort=seconds,
                    known=True,
                )
                return True
    return False


def _other_planner(case: Case, request: PlanRequest) -> bool:
    if (request.planner_id, request.pipeline_id) == tuple(DEFAULT.values()):
        return False
    changed = replace(request, **DEFAULT, parameters={}, planning_time=max(request.planning_time, SHORT))
    if case.succeeds(case.scene, changed, SHORT) is None:
        return False
    case.suggest(
        "plan with RRTConnect of pipeline native, which finds a path",
        change_request,
        {**DEFAULT, "parameters": {}, "planning_time": changed.planning_time},
        known=True,
    )
    return True


def _less_padding(case: Case, request: PlanRequest) -> None:
    """The largest padding with which a path is found, where there is any and it matters."""
    scene = case.scene
    most = max([scene.padding, *scene.link_padding.values()])
    if most <= 0 or case.succeeds(padded(scene, 0.0), request, SHORT) is None:
        return
    low, high = 0.0, most
    for _ in range(4):
        middle = (low + high) / 2
        found = case.succeeds(padded(scene, middle), request, SHORT) is not None
        low, high = (middle, high) if found else (low, middle)
    case.say(f"with a padding of {words.length(most)} there is no path, with {words.length(low)} there is")
    case.suggest(
        f"reduce the padding to {words.length(low)}",
        change_padding,
        {"padding": low},
        effort=most - low,
        known=True,
    )


def _in_the_way(case: Case, request: PlanRequest) -> None:
    """The fewest objects without which there is a path: one, two, or as many as it takes."""
    names = _by_suspicion(case)

    def opens(gone: tuple[str, ...] | list[str]) -> bool:
        return case.succeeds(without(case.scene, gone), request, SHORT) is not None

    if not names:
        case.say("there is no object in the scene: it is the robot itself that is in the way")
        return
    if not opens(names):
        case.say(f"no object is to blame: even without {_and(names)} no path is found in {SHORT:g} s")
        return
    single = [name for name in names if opens([name])]
    if single:
        blocking = [[name] for name in single]
        case.say("; ".join(f"without {name} there is a path" for name in single))
    else:
        pairs = list(combinations(names, 2))[:MOST_PAIRS]
        pair = next((sorted(p) for p in pairs if opens(p)), None)
        if pair is None:  # of all of them, leave out who is not needed
            pair = list(names)
            for name in names:
                fewer = [n for n in pair if n != name]
                pair = fewer if opens(fewer) else pair
        case.say(f"no single object blocks the way: {_and(pair)} do together")
        blocking = [pair]
    case.data["blocking"] = blocking
    for gone in blocking:
        case.suggest(
            f"take {_and(gone)} out of the way",
            remove_objects,
            {"names": gone},
            effort=float(len(gone)),
            known=True,
        )


def _by_suspicion(case: Case) -> list[str]:
    """Objects of the scene, those first that the search ran into."""
    met = [n for c in case.contacts for n in (c.body_a, c.body_b)]
    return sorted(case.scene.objects, key=lambda name: (name not in met, name))


def _and(names: list[str]) -> str:
    return " and ".join((", ".join(names[:-1]), names[-1])) if len(names) > 1 else names[0]


def _not_so_far(case: Case, request: PlanRequest) -> None:
    """The goal nearest to the one asked for, among a few between start and goal, that can be reached."""
    for number, goal in enumerate(request.goals[:1]):
        for share in ALONG:
            if isinstance(goal, PoseGoal):
                found = _pose_between(case, goal, share)
            elif isinstance(goal, JointGoal | NamedGoal):
                found = _joints_between(case, goal, share)
            else:
                return
            if found is None:
                continue
            changed, q, text = found
            asked = replace(request, goals=(changed,))
            if case.succeeds(case.scene, asked, SHORT) is None:
                continue
            case.nearest = case.group_state(q)
            case.suggest(
                f"go {share:.0%} of the way: {text}",
                change_goal,
                {"number": number, "goal": changed},
                effort=1 - share,
                known=True,
            )
            return


def _pose_between(case: Case, goal: PoseGoal, share: float):
    search = PoseSearch(case.started, case.request.group, goal.link, case.checker.is_free, 0, case.deadline)
    there = goal.T_world_link
    here = case.started.frame_pose(search.ik.tip_link)
    pose = here.interpolate(there, share)
    q = search.reached(pose)
    if q is None:
        return None
    step = pose.translation - there.translation
    changed = PoseGoal(pose, goal.link, goal.position_tolerance, goal.orientation_tolerance)
    return changed, q, f"the goal moved {words.offset(step)}"


def _joints_between(case: Case, goal: JointGoal | NamedGoal, share: float):
    wanted = wanted_joints(case, goal)
    if wanted is None:
        return None
    q = case.start + share * (wanted - case.start)
    if not case.checker.is_free(q):
        return None
    text = words.joint_steps(case.scene.model, case.joint_names, q - wanted)
    return JointGoal(JointState(case.joint_names, q)), q, f"the goal changed {text}"


def _too_weak(case: Case, joint: str, torque: float, limit: float) -> None:
    """How much less the robot may carry."""
    case.say(f"{joint} takes {torque:.3g} to hold still, and has {limit:.3g} (Nm or N)")
    for name, body in case.scene.attached.items():
        low, high = 0.0, body.object.mass_kg
        for _ in range(6):
            middle = (low + high) / 2
            scene, request = change_mass(case.scene, case.request, name, middle)
            found = case.succeeds(scene, request, SHORT) is not None
            low, high = (middle, high) if found else (low, middle)
        if low > 0:
            text = f"carry less: {name} of {low:.2g} kg instead of {body.object.mass_kg:.3g} kg"
            case.suggest(
                text,
                change_mass,
                {"name": name, "mass": float(f"{low:.2g}")},
                effort=body.object.mass_kg - low,
            )
    case.suggest(
        "plan without torque limits, if the robot is known to be strong enough",
        change_request,
        {"torque_limits": False},
        effort=np.inf,
    )
