"""Diagnosis of a failed search between valid start and goals.

The cause is too little time, or obstacles between start and goals.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from armcell.core import ErrorCode, JointGoal, JointState, NamedGoal, PlanRequest, PoseGoal
from armcell.planning.diagnosis import text_format
from armcell.planning.diagnosis.changes import (
    change_goal,
    change_mass,
    change_padding,
    change_request,
    padded,
    remove_objects,
    without,
)
from armcell.planning.diagnosis.constraints import diagnose_path_constraints
from armcell.planning.diagnosis.diagnosis import TRY, Diagnosis, report_limit_margins, wanted_joints
from armcell.planning.diagnosis.nearest_free import PoseSearch

SHORT = 0.5  # [s] planning time of one test
MOST_PAIRS = 15
ALONG = (0.9, 0.75, 0.5, 0.25)  # shares of the path from start to goal to try
DEFAULT = {"planner_id": "RRTConnect", "pipeline_id": "native"}


def explain_search_failure(diagnosis: Diagnosis) -> None:
    """Diagnose why the search for a path failed: test whether more time, another planner, less padding or
    fewer objects help.
    """
    request = diagnosis.request
    assert isinstance(request, PlanRequest)
    if diagnosis.result.code is ErrorCode.PREEMPTED:
        diagnosis.add_finding("it was cancelled: nothing is known to be wrong with it")
        diagnosis.suggest("ask again", change_request)
        return
    report_limit_margins(diagnosis)
    evidence = diagnosis.result.evidence
    if "torque" in evidence:
        _too_weak(diagnosis, evidence["joint"], evidence["torque"], evidence["limit"])
        return
    _report_search(diagnosis)
    if (
        diagnose_path_constraints(diagnosis)
        or _more_time(diagnosis, request)
        or _other_planner(diagnosis, request)
    ):
        return
    _less_padding(diagnosis, request)
    _in_the_way(diagnosis, request)
    _not_so_far(diagnosis, request)


def _report_search(diagnosis: Diagnosis) -> None:
    """Report statistics of a failed path search, and the contacts that it encountered."""
    evidence = diagnosis.result.evidence
    blocked = evidence.get("blocked_by", [])
    if "closest_approach_rad" in evidence:
        near = f"; there {text_format.contacts(blocked)}" if blocked else ""
        diagnosis.add_finding(
            f"the search came within {evidence['closest_approach_rad']:.2f} rad of a path{near}"
        )
        diagnosis.data["closest_approach_rad"] = evidence["closest_approach_rad"]
    diagnosis.contacts = list(blocked)


def _more_time(diagnosis: Diagnosis, request: PlanRequest) -> bool:
    """Test whether a failed search finds a path with more planning time. Skip the test if the request already
    allowed two seconds (TRY) or more.

    Two seconds without success are conclusive.
    """
    if request.planning_time >= TRY:
        return False
    for seconds in (0.1, 0.5, TRY):
        if seconds > request.planning_time:
            result = diagnosis.succeeds(diagnosis.scene, replace(request, planning_time=seconds), seconds)
            if result is not None:
                diagnosis.add_finding(
                    f"with {seconds:g} s a path is found, after {result.planning_time:.3g} s"
                )
                diagnosis.suggest(
                    f"give planning_time {seconds:g} s",
                    change_request,
                    {"planning_time": seconds},
                    effort=seconds,
                    known=True,
                )
                return True
    return False


def _other_planner(diagnosis: Diagnosis, request: PlanRequest) -> bool:
    if (request.planner_id, request.pipeline_id) == tuple(DEFAULT.values()):
        return False
    changed = replace(request, **DEFAULT, parameters={}, planning_time=max(request.planning_time, SHORT))
    if diagnosis.succeeds(diagnosis.scene, changed, SHORT) is None:
        return False
    diagnosis.suggest(
        "plan with RRTConnect of pipeline native, which finds a path",
        change_request,
        {**DEFAULT, "parameters": {}, "planning_time": changed.planning_time},
        known=True,
    )
    return True


def _less_padding(diagnosis: Diagnosis, request: PlanRequest) -> None:
    """Find the largest padding with which a failed search succeeds when it is repeated."""
    scene = diagnosis.scene
    most = max([scene.padding, *scene.link_padding.values()])
    if most <= 0 or diagnosis.succeeds(padded(scene, 0.0), request, SHORT) is None:
        return
    low, high = 0.0, most
    for _ in range(4):
        middle = (low + high) / 2
        found = diagnosis.succeeds(padded(scene, middle), request, SHORT) is not None
        low, high = (middle, high) if found else (low, middle)
    blocked, passable = text_format.length(most), text_format.length(low)
    diagnosis.add_finding(f"with a padding of {blocked} there is no path, with {passable} there is")
    diagnosis.suggest(
        f"reduce the padding to {text_format.length(low)}",
        change_padding,
        {"padding": low},
        effort=most - low,
        known=True,
    )


def _in_the_way(diagnosis: Diagnosis, request: PlanRequest) -> None:
    """Find the smallest set of objects that must be removed so that a failed search finds a path."""
    names = _by_suspicion(diagnosis)

    def opens(gone: tuple[str, ...] | list[str]) -> bool:
        return diagnosis.succeeds(without(diagnosis.scene, gone), request, SHORT) is not None

    if not names:
        diagnosis.add_finding("the scene has no objects: the robot itself blocks the path")
        return
    if not opens(names):
        diagnosis.add_finding(
            f"no object is to blame: even without {_and(names)} no path is found in {SHORT:g} s"
        )
        return
    single = [name for name in names if opens([name])]
    if single:
        blocking = [[name] for name in single]
        diagnosis.add_finding("; ".join(f"without {name} there is a path" for name in single))
    else:
        pairs = list(combinations(names, 2))[:MOST_PAIRS]
        pair = next((sorted(p) for p in pairs if opens(p)), None)
        if pair is None:  # start with all objects, then leave out unnecessary ones
            pair = list(names)
            for name in names:
                fewer = [n for n in pair if n != name]
                pair = fewer if opens(fewer) else pair
        diagnosis.add_finding(f"no single object blocks the path: {_and(pair)} do together")
        blocking = [pair]
    diagnosis.data["blocking"] = blocking
    for gone in blocking:
        diagnosis.suggest(
            f"remove {_and(gone)}",
            remove_objects,
            {"names": gone},
            effort=float(len(gone)),
            known=True,
        )


def _by_suspicion(diagnosis: Diagnosis) -> list[str]:
    """Sort the names of the scene's objects for a diagnosis: objects in the contacts of the failed search
    come first.
    """
    met = [n for c in diagnosis.contacts for n in (c.body_a, c.body_b)]
    return sorted(diagnosis.scene.objects, key=lambda name: (name not in met, name))


def _and(names: list[str]) -> str:
    return " and ".join((", ".join(names[:-1]), names[-1])) if len(names) > 1 else names[0]


def _not_so_far(diagnosis: Diagnosis, request: PlanRequest) -> None:
    """Find a reachable goal that is as near as possible to the goal for which the search failed.

    The candidates are a few configurations between start and goal.
    """
    for number, goal in enumerate(request.goals[:1]):
        for share in ALONG:
            if isinstance(goal, PoseGoal):
                found = _pose_between(diagnosis, goal, share)
            elif isinstance(goal, JointGoal | NamedGoal):
                found = _joints_between(diagnosis, goal, share)
            else:
                return
            if found is None:
                continue
            changed, q, text = found
            asked = replace(request, goals=(changed,))
            if diagnosis.succeeds(diagnosis.scene, asked, SHORT) is None:
                continue
            diagnosis.nearest = diagnosis.group_state(q)
            diagnosis.suggest(
                f"go {share:.0%} of the distance: {text}",
                change_goal,
                {"number": number, "goal": changed},
                effort=1 - share,
                known=True,
            )
            return


def _pose_between(diagnosis: Diagnosis, goal: PoseGoal, share: float):
    search = PoseSearch(
        diagnosis.start_scene,
        diagnosis.request.group,
        goal.link,
        diagnosis.checker.is_free,
        0,
        diagnosis.deadline,
    )
    there = goal.T_world_link
    here = diagnosis.start_scene.frame_pose(search.ik.tip_link)
    pose = here.interpolate(there, share)
    q = search.reached(pose)
    if q is None:
        return None
    step = pose.translation - there.translation
    changed = PoseGoal(pose, goal.link, goal.position_tolerance, goal.orientation_tolerance)
    return changed, q, f"the goal moved {text_format.offset(step)}"


def _joints_between(diagnosis: Diagnosis, goal: JointGoal | NamedGoal, share: float):
    wanted = wanted_joints(diagnosis, goal)
    if wanted is None:
        return None
    q = diagnosis.start + share * (wanted - diagnosis.start)
    if not diagnosis.checker.is_free(q):
        return None
    text = text_format.joint_steps(diagnosis.scene.model, diagnosis.joint_names, q - wanted)
    return JointGoal(JointState(diagnosis.joint_names, q)), q, f"the goal changed {text}"


def _too_weak(diagnosis: Diagnosis, joint: str, torque: float, limit: float) -> None:
    """Explain that a search failed because every path exceeds a torque limit, and suggest a smaller
    payload.
    """
    diagnosis.add_finding(f"{joint} takes {torque:.3g} to hold still, and has {limit:.3g} (Nm or N)")
    for name, body in diagnosis.scene.attached.items():
        low, high = 0.0, body.object.mass_kg
        for _ in range(6):
            middle = (low + high) / 2
            scene, request = change_mass(diagnosis.scene, diagnosis.request, name, middle)
            found = diagnosis.succeeds(scene, request, SHORT) is not None
            low, high = (middle, high) if found else (low, middle)
        if low > 0:
            text = f"carry less: {name} of {low:.2g} kg instead of {body.object.mass_kg:.3g} kg"
            diagnosis.suggest(
                text,
                change_mass,
                {"name": name, "mass": float(f"{low:.2g}")},
                effort=body.object.mass_kg - low,
            )
    diagnosis.suggest(
        "plan without torque limits, if the robot is known to be strong enough",
        change_request,
        {"torque_limits": False},
        effort=np.inf,
    )
