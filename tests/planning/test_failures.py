"""plan() fails with a code, a reason and evidence; misuse raises."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest
from tests.planning.helpers import down, panda_wall, request, walled_in
from tests.scene.helpers import box, panda

from armcell.core import (
    SE3,
    ErrorCode,
    InputError,
    JointGoal,
    JointState,
    NamedGoal,
    PoseGoal,
    UnknownNameError,
)
from armcell.planning import plan


def failed(result, code: ErrorCode) -> str:
    assert result.code is code, (result.code, result.message)
    assert not result and result.path is None and result.trajectory is None
    assert result.message and "\n" not in result.message
    return result.message


def pairs(result) -> list[set[str]]:
    return [{c.body_a, c.body_b} for c in result.evidence["contacts"]]


def test_start_in_collision_names_the_pair():
    scene = panda(box("block", (0.1, 0.1, 0.1), (0.307, 0.0, 0.62)))
    result = plan(scene, request(NamedGoal("extended")))
    text = failed(result, ErrorCode.START_STATE_IN_COLLISION)
    assert "block" in text and "panda_hand touches" in text and " mm deep" in text
    assert {"panda_hand", "block"} in pairs(result)


def test_start_in_self_collision_names_the_links():
    scene = panda(joint2=-1.5, joint4=-3.0, joint6=0.5)
    result = plan(scene, request(NamedGoal("home")))
    text = failed(result, ErrorCode.START_STATE_IN_COLLISION)
    assert "panda_link2 touches panda_rightfinger" in text
    assert {"panda_hand", "panda_link2"} in pairs(result)


def test_a_start_within_the_padding_may_leave():
    home = panda().frame_pose("panda_hand_tcp").translation
    plate = box("plate", (0.3, 0.3, 0.02), home - (0, 0, 0.03))
    scene = panda(plate).with_padding(0.02)  # the finger tips are about 1 cm above it
    result = plan(scene, request(JointGoal(JointState(("panda_joint4",), [-2.0]))))
    assert result.ok, result.message


@pytest.mark.parametrize(
    ("goal", "link"),
    [
        (PoseGoal(down(0.55, 0.0, 0.2)), "panda_"),
        (JointGoal(JointState(("panda_joint1", "panda_joint2"), [0.0, 0.6])), "panda_"),
    ],
    ids=["pose", "joints"],
)
def test_goal_in_collision_names_the_pair(goal, link):
    result = plan(panda_wall(), request(goal))
    text = failed(result, ErrorCode.GOAL_IN_COLLISION)
    assert link in text and ("wall" in text or "table" in text)
    assert any(p & {"wall", "table"} for p in pairs(result))


def test_out_of_reach_is_told_with_evidence():
    target = down(1.5, 0.0, 0.2)
    result = plan(panda_wall(), request(PoseGoal(target)))
    text = failed(result, ErrorCode.NO_IK_SOLUTION)
    assert "panda_hand_tcp cannot reach" in text and "mm" in text
    evidence = result.evidence
    assert evidence["closest_pose"].distance_to(target)[0] > 0.3
    # The Panda's arm is 0.855 m long (its data sheet), from the shoulder at 0.333 m to the flange.
    assert evidence["distance_m"] == pytest.approx(np.hypot(1.5, 0.333 - 0.2), abs=1e-3)
    assert evidence["distance_m"] > evidence["reach_m"] > 0.855
    assert evidence["target"].isclose(target)


def test_a_goal_out_of_limits_names_the_joint():
    result = plan(panda_wall(), request(JointGoal(JointState(("panda_joint4",), [0.5]))))
    text = failed(result, ErrorCode.GOAL_STATE_INVALID)
    assert "panda_joint4" in text and "0.5" in text and "-0.0698" in text


def test_a_start_out_of_limits_names_the_joint():
    start = JointState(("panda_joint4",), [0.5])
    result = plan(panda_wall(), request(NamedGoal("home"), start=start))
    assert "panda_joint4" in failed(result, ErrorCode.START_STATE_INVALID)


def test_no_goal():
    failed(plan(panda_wall(), request(())), ErrorCode.INVALID_GOAL_CONSTRAINTS)


NAMES_NOTHING = {
    "group": ({"group": "arms"}, "planning group 'arms'; known: arm"),
    "planner": ({"planner_id": "RTTConnect"}, "planner .*'RTTConnect'; known: .*mean 'RRTConnect'"),
    "pipeline": ({"pipeline_id": "omlp"}, "pipeline 'omlp'; known: .*mean 'ompl'"),
    "link": ({"goals": (PoseGoal(down(0.5, 0.2, 0.2), link="hand"),)}, "link 'hand'; known: "),
    "state": ({"goals": (NamedGoal("hom"),)}, "'hom'; known: extended, home"),
}
WRONG = {
    "goal joint": ({"goals": (JointGoal(JointState(("panda_joint9",), [0.0])),)}, "joint 'panda_joint9'"),
    "start joint": ({"start": JointState(("panda_joint9",), [0.0])}, "joint 'panda_joint9'"),
}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        *NAMES_NOTHING.values(),
        *WRONG.values(),
    ],
    ids=[*NAMES_NOTHING, *WRONG],
)
def test_unknown_names_raise_and_list(change, words):
    from dataclasses import replace

    with pytest.raises(UnknownNameError, match=words):
        plan(panda_wall(), replace(request(NamedGoal("home")), **change))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["velocity_scaling", "acceleration_scaling"])
@pytest.mark.parametrize("value", [0.0, -1.0, 1.5, np.nan])
def test_scaling_is_checked(kind, value):
    with pytest.raises(InputError, match=r"scaling is .*must be (in \(0, 1\]|a number)"):
        plan(panda_wall(), request(NamedGoal("home"), **{kind: value}))


@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0])
def test_the_time_is_checked(value):
    scene, goal = walled_in()
    cancel = threading.Event()
    threading.Timer(0.2, cancel.set).start()  # or it might never end
    with pytest.raises(InputError, match="planning_time"):
        plan(scene, request(goal, planning_time=value), cancel)


def test_a_pose_of_nan_is_refused():
    with pytest.raises(InputError):
        plan(panda_wall(), request(PoseGoal(SE3.from_matrix(np.full((4, 4), np.nan)))))


def test_a_group_without_a_tip_needs_a_link():
    from armcell.core import PlanRequest

    with pytest.raises(InputError, match="is not a chain"):
        plan(panda_wall(), PlanRequest("arm_and_hand", (PoseGoal(down(0.5, 0.2, 0.3)),)))


@pytest.mark.slow
@pytest.mark.cases("0.3")
@pytest.mark.parametrize("seconds", [0.3, 1.0])
def test_a_problem_without_solution_ends_in_time(seconds):
    scene, goal = walled_in()
    began = time.monotonic()
    result = plan(scene, request(goal, planning_time=seconds))
    spent = time.monotonic() - began
    text = failed(result, ErrorCode.TIMED_OUT)
    assert "RRTConnect" in text and result.planner_id == "RRTConnect"
    assert seconds <= spent < seconds + 5.0 and result.planning_time == pytest.approx(spent, abs=0.1)


def test_cancelling_ends_at_once():
    scene, goal = walled_in()
    cancel, at = threading.Event(), []

    def stop():
        at.append(time.monotonic())
        cancel.set()

    timer = threading.Timer(0.3, stop)
    timer.start()
    result = plan(scene, request(goal, planning_time=20.0), cancel)
    assert time.monotonic() - at[0] < 10.0  # far below the time it was given
    assert "cancelled" in failed(result, ErrorCode.PREEMPTED)
    timer.join()


def test_cancelled_before_it_began():
    scene, goal = walled_in()
    cancel = threading.Event()
    cancel.set()
    failed(plan(scene, request(goal), cancel), ErrorCode.PREEMPTED)
