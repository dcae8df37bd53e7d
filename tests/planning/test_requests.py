"""Options of a request: attempts, workspace, speed, start states, adapters."""

from __future__ import annotations

import time

import numpy as np
import pinocchio as pin
import pytest
from tests.model.helpers import pin_library
from tests.planning.helpers import down, judge, panda_wall, request, walled_in
from tests.planning.test_plan import beyond_panda
from tests.scene.helpers import box, panda

from armcell.collision import ExactChecker
from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.resting_contact import certify_from_rest
from armcell.core import ADAPTERS, ErrorCode, InputError, JointGoal, JointState, PoseGoal, UnknownNameError
from armcell.kinematics import ik_solver
from armcell.planning import adapter_names, plan

REPAIR = ("fix_start_state_collision", *ADAPTERS)


def tip_positions(trajectory, step: float) -> np.ndarray:
    """(k, 3) of a Panda's tip along a motion, by pinocchio."""
    model = pin_library("panda")
    data, frame = model.createData(), model.getFrameId("panda_hand_tcp", pin.FrameType.BODY)
    columns = [model.joints[model.getJointId(name)].idx_q for name in trajectory.joint_names]
    out = []
    for t in np.arange(0.0, trajectory.duration + step, step):
        q = pin.neutral(model)
        q[columns] = trajectory.sample(t)[0]
        pin.framesForwardKinematics(model, data, q)
        out.append(data.oMf[frame].translation.copy())
    return np.array(out)


# --- attempts ---


def test_of_several_attempts_the_shortest_is_taken():
    scene, goal = panda_wall(), beyond_panda()
    one = plan(scene, request(goal, seed=4))
    many = plan(scene, request(goal, seed=4, attempts=6))
    assert one.ok and many.ok
    judge(scene, many.trajectory)
    lengths = many.evidence["lengths"]
    assert many.evidence["attempts"] == many.evidence["solved"] == len(lengths) == 6
    assert many.path.length == pytest.approx(min(lengths)) and len(set(lengths)) > 1
    assert lengths[0] == pytest.approx(one.path.length)  # the first attempt is the only one of the other
    again = plan(scene, request(goal, seed=4, attempts=6))
    np.testing.assert_array_equal(many.trajectory.positions, again.trajectory.positions)


@pytest.mark.slow
def test_attempts_that_all_fail_say_so():
    scene, goal = walled_in()
    result = plan(scene, request(goal, attempts=3, planning_time=0.3))
    assert result.code is ErrorCode.TIMED_OUT and result.planning_time < 30.0
    assert result.evidence["attempts"] == 3 and result.evidence["solved"] == 0


@pytest.mark.parametrize("attempts", [0, -1, 1.5])
def test_impossible_attempts(attempts):
    with pytest.raises(InputError, match="attempts"):
        plan(panda_wall(), request(beyond_panda(), attempts=attempts))


# --- workspace ---


def test_the_tip_stays_in_the_workspace():
    scene, goal = panda_wall(), beyond_panda()
    free = tip_positions(plan(scene, request(goal)).trajectory, 0.01)
    low, high = free.min(0) - 0.1, free.max(0) + 0.1
    result = plan(scene, request(goal, workspace=(tuple(low), tuple(high))))
    assert result.ok, result.message
    tips = tip_positions(result.trajectory, 0.01)
    assert np.all(tips >= low - 1e-3) and np.all(tips <= high + 1e-3)


def test_a_motion_that_would_leave_the_workspace_is_refused():
    scene, goal = panda_wall(), beyond_panda()
    tips = tip_positions(plan(scene, request(goal)).trajectory, 0.01)
    ceiling = max(tips[0, 2], tips[-1, 2]) + 0.01
    assert ceiling < tips[:, 2].max()  # the way leads over the wall
    result = plan(scene, request(goal, workspace=((-1, -1, -1), (2, 1, ceiling)), planning_time=2.0))
    assert not result.ok and result.trajectory is None
    assert "leave the workspace" in result.message and "mm outside" in result.message


def test_a_goal_outside_of_the_workspace_is_named():
    inside = ((0.0, -1.0, 0.0), (1.0, 0.2, 1.0))
    for goal in (PoseGoal(down(0.5, 0.25, 0.2)), beyond_panda()):
        result = plan(panda_wall(), request(goal, workspace=inside))
        assert result.code is ErrorCode.INVALID_GOAL_CONSTRAINTS
        assert "goal: panda_hand_tcp at (0.5, 0.25, " in result.message
        assert "50 mm outside the workspace" in result.message


def test_a_start_outside_of_the_workspace_is_named():
    result = plan(panda_wall(), request(beyond_panda(), workspace=((-1, 0, -1), (1, 1, 1))))
    assert result.code is ErrorCode.START_STATE_INVALID and "outside the workspace" in result.message


@pytest.mark.parametrize("corners", [((0, 0, 0), (1, 0, 1)), ((0, 0), (1, 1)), ((0, 0, 0), (1, 1, np.nan))])
def test_impossible_workspaces(corners):
    with pytest.raises(InputError, match="workspace"):
        plan(panda_wall(), request(beyond_panda(), workspace=corners))


# --- speed of a link ---


@pytest.mark.slow
@pytest.mark.cases("0.3")
@pytest.mark.parametrize("speed", [0.15, 0.3])
def test_the_tip_s_speed_is_limited(speed):
    scene = panda_wall()
    fast = plan(scene, request(beyond_panda(), seed=1))
    slow = plan(scene, request(beyond_panda(), seed=1, max_cartesian_speed=speed))
    step = 0.004
    peak = [
        np.linalg.norm(np.diff(tip_positions(r.trajectory, step), axis=0), axis=1).max() / step
        for r in (fast, slow)
    ]
    assert peak[0] > speed and 0.97 * speed < peak[1] <= 1.005 * speed
    judge(scene, slow.trajectory)
    np.testing.assert_array_equal(slow.trajectory.positions, fast.trajectory.positions)  # in time only


def test_the_speed_of_another_link():
    goal = JointGoal(JointState(("panda_joint7",), [1.5]))  # the tip turns on the spot
    tip, nothing, elbow = (
        plan(panda_wall(), request(goal, max_cartesian_speed=0.01, speed_link=link)).trajectory.duration
        for link in (None, "panda_link7", "panda_leftfinger")
    )
    assert nothing == pytest.approx(tip, rel=0.01) and elbow > 2 * tip


def test_an_impossible_speed():
    with pytest.raises(InputError, match="max_cartesian_speed"):
        plan(panda_wall(), request(beyond_panda(), max_cartesian_speed=0.0))
    with pytest.raises(UnknownNameError, match="link 'nose'"):
        plan(panda_wall(), request(beyond_panda(), max_cartesian_speed=1.0, speed_link="nose"))


# --- adapters ---


def test_unknown_adapters_list_what_exists():
    with pytest.raises(UnknownNameError, match="unknown adapter 'smooth'; known: ") as error:
        plan(panda_wall(), request(beyond_panda(), adapters=("smooth", "validation")))
    assert {*adapter_names()} >= {*ADAPTERS, "fix_start_state_collision"}
    assert all(name in str(error.value) for name in adapter_names())


def test_moveit_s_names_are_understood():
    names = (
        "default_planning_request_adapters/CheckStartStateBounds",
        "default_planning_request_adapters/ResolveConstraintFrames",
        "default_planning_response_adapters/AddTimeOptimalParameterization",
        "default_planning_response_adapters/ValidateSolution",
    )
    assert plan(panda_wall(), request(beyond_panda(), adapters=names)).ok


def test_validation_cannot_be_left_out():
    with pytest.raises(InputError, match="'validation' is left out"):
        plan(panda_wall(), request(beyond_panda(), adapters=("timing",)))


def test_without_timing_there_is_a_proven_path_only():
    result = plan(panda_wall(), request(beyond_panda(), adapters=("validation",)))
    assert result.ok and result.trajectory is None and len(result.path.waypoints) >= 2
    assert result.min_clearance == np.inf or result.min_clearance > 0


def out_of_bounds(by: float) -> JointState:
    scene = panda_wall()
    upper = scene.model.joint("panda_joint7").limits.upper
    return JointState(("panda_joint7",), [upper + by])


def test_a_start_slightly_out_of_limits_is_moved_in_and_reported():
    scene, start = panda_wall(), out_of_bounds(0.03)
    goal = JointGoal(JointState(("panda_joint7",), [1.0]))
    result = plan(scene, request(goal, start=start))
    assert result.ok, result.message
    was, now = result.evidence["start_moved_within_limits"]["panda_joint7"]
    assert was == pytest.approx(2.9273) and now == pytest.approx(2.8973)
    q = result.trajectory.positions[:, 6]
    assert q[0] == pytest.approx(2.9273) and np.all(np.diff(q) <= 1e-12)  # from where it is, always inwards
    assert result.path.waypoints[0][6] == pytest.approx(2.9273)
    v = [result.trajectory.sample(t)[1] for t in np.arange(0, result.trajectory.duration, 0.002)]
    limits = scene.model.limits(result.trajectory.joint_names, "velocity")
    assert np.all(np.abs(v) <= limits * 1.001)


def test_the_way_into_limits_keeps_jerk_limits_too():
    scene = panda_wall()
    goal = JointGoal(JointState(("panda_joint7",), [1.0]))
    result = plan(scene, request(goal, start=out_of_bounds(0.03), jerk_limits=True))
    assert result.ok, result.message
    trajectory, step = result.trajectory, 5e-4
    q = np.array([trajectory.sample(t)[0] for t in np.arange(0.0, trajectory.duration + step, step)])
    jerk = scene.model.limits(trajectory.joint_names, "jerk")
    assert np.max(np.abs(np.diff(q, 3, axis=0)) / step**3 / jerk) <= 1.001


def test_too_far_out_or_without_the_adapter_it_is_refused():
    goal = JointGoal(JointState(("panda_joint7",), [1.0]))
    for start, adapters in ((out_of_bounds(0.08), ADAPTERS), (out_of_bounds(0.03), ("timing", "validation"))):
        result = plan(panda_wall(), request(goal, start=start, adapters=adapters))
        assert result.code is ErrorCode.START_STATE_INVALID and "panda_joint7" in result.message


def in_contact(depth: float):
    """A plate below the finger tips, which reach `depth` [m] into it."""
    scene = panda()
    tip = scene.frame_pose("panda_hand_tcp").translation
    lowest = tip[2] - 0.0095  # of the finger tips' skin, below the tip frame; measured by the exact checker
    plate = box("plate", (0.3, 0.3, 0.02), (tip[0], tip[1], lowest - 0.01 + depth))
    return panda(plate)


def test_a_start_in_contact_is_repaired_only_when_asked():
    scene = in_contact(0.004)
    names = scene.model.group("arm").joint_names
    contacts = ExactChecker(scene, names).contacts(scene.positions[:7], padded=False)
    assert contacts and contacts[0].distance > -0.01
    goal = JointGoal(JointState(("panda_joint1",), [0.8]))
    assert plan(scene, request(goal)).code is ErrorCode.START_STATE_IN_COLLISION
    result = plan(scene, request(goal, adapters=REPAIR))
    assert result.ok, result.message
    report = result.evidence["start_repaired"]
    assert {c.body_b for c in report["contacts"]} | {c.body_a for c in report["contacts"]} >= {"plate"}
    np.testing.assert_array_equal(report["from"], scene.positions[:7])
    assert 0 < report["distance"] < 0.3
    assert report["distance"] == pytest.approx(np.linalg.norm(report["to"] - report["from"]))
    checker = ExactChecker(scene, names)
    assert checker.is_free(report["to"])
    begins = result.trajectory.positions[0]
    if report["begins_at"] == "actual start":
        np.testing.assert_allclose(begins, report["from"])
    else:
        np.testing.assert_allclose(begins, report["to"])
        assert "begins at the repaired start" in result.message
    # From the repaired state on it is as free as any motion; before, no contact grows deeper.
    depth = max(-c.distance for c in contacts)
    free = False
    for t in np.arange(0.0, result.trajectory.duration, 0.004):
        q = result.trajectory.sample(t)[0]
        now = checker.contacts(q, padded=False)
        assert not (free and now)
        assert all(-c.distance <= depth + 1e-3 for c in now)
        free = free or not now
    assert free


def least_freeing_shift(checker: KernelChecker, start: np.ndarray, free: np.ndarray) -> bool:
    return certify_from_rest(checker, [start, free], deepest=np.inf).free


def test_a_way_out_may_not_lead_deeper_or_into_another_contact():
    scene = in_contact(0.004)
    ik, names = ik_solver(scene.model, "arm"), scene.model.group("arm").joint_names
    checker, start = KernelChecker(scene, names), scene.positions[:7]

    def tip_at(dz: float) -> np.ndarray:
        full = scene.positions.copy()
        ik.descend(full, scene.frame_pose("panda_hand_tcp").shifted(z=dz))
        return full[:7]

    assert least_freeing_shift(checker, start, tip_at(0.03))
    assert not least_freeing_shift(checker, start, tip_at(-0.01))  # into the plate
    assert not least_freeing_shift(checker, start, tip_at(-0.25))  # through it, free again below
    tip = scene.frame_pose("panda_hand_tcp").translation
    above = scene.with_object(box("above", (0.3, 0.3, 0.02), tip + np.array([0, 0, 0.25])))
    assert not least_freeing_shift(KernelChecker(above, names), start, tip_at(0.08))


@pytest.mark.slow
def test_a_start_that_cannot_be_repaired_is_refused_in_time():
    tip = panda().frame_pose("panda_hand_tcp").translation
    scene = panda(box("block", (0.8, 0.8, 0.8), tip))
    began = time.monotonic()
    result = plan(scene, request(JointGoal(JointState(("panda_joint1",), [0.8])), adapters=REPAIR))
    assert result.code is ErrorCode.START_STATE_IN_COLLISION and "no free state within" in result.message
    assert time.monotonic() - began < 10.0
