"""PTP, LIN and CIRC as MoveIt's unit tests for Pilz want them; pinocchio says where the tip is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.planning.helpers import judge
from tests.planning.pilz.reference import Watched, tip, tip_of, told
from tests.scene.helpers import box, panda, ur10

from armcell.core import (
    SE3,
    Constraints,
    ErrorCode,
    InputError,
    JointConstraint,
    JointGoal,
    JointState,
    NamedGoal,
    PlanRequest,
    PoseGoal,
    PositionConstraint,
    Sphere,
    UnknownNameError,
)
from armcell.planning import plan

each_robot = pytest.mark.parametrize("robot", [panda, ur10])


def aside(T: SE3) -> SE3:
    return T.shifted(0.05, 0.2, -0.15) @ SE3.from_xyz_rpy((0, 0, 0), (0.1, 0.1, 0.4))


def joints(scene, *steps: float) -> JointGoal:
    names = scene.model.group("arm").joint_names
    q = scene.positions[scene.model.columns(names)].copy()
    q[: len(steps)] += steps
    return JointGoal(JointState(names, q))


# --- PTP ---
@pytest.mark.slow
@each_robot
def test_ptp_joints_start_cruise_brake_and_end_together(robot):
    scene = robot()
    goal = joints(scene, 0.9, -0.3, 0.2, -0.4)
    result = plan(scene, told("PTP", goal, 0.5, 0.3))
    assert result.ok and result.planner_id == "PTP", result.message
    judge(scene, result.trajectory, 0.5, 0.3)
    np.testing.assert_array_equal(result.trajectory.positions[-1], goal.state.positions)
    seen = Watched(scene, result.trajectory, tip_of(scene))
    ways = goal.state.positions - seen.q[0]
    share = (seen.q - seen.q[0]) @ ways / (ways @ ways)
    np.testing.assert_allclose(seen.q, seen.q[0] + share[:, None] * ways, atol=1e-10)  # phase-synchronous
    model, names = scene.model, result.trajectory.joint_names
    fastest = np.abs(seen.v).max(axis=0) / (0.5 * model.limits(names, "velocity"))
    hardest = np.abs(seen.a).max(axis=0) / (0.3 * model.limits(names, "acceleration"))
    assert max(fastest.max(), hardest.max()) <= 1 + 1e-6
    assert hardest.max() == pytest.approx(1.0, abs=1e-3)  # and one joint leads, at its limit
    # one shape for all: what a joint does is the leading joint's motion, scaled
    np.testing.assert_allclose(seen.v * ways[0], seen.v[:, :1] * ways, atol=1e-9)


def test_ptp_to_a_pose_and_to_a_name():
    scene = panda()
    result = plan(scene, told("PTP", aside(tip(scene))))
    assert result.ok
    judge(scene, result.trajectory, 0.3, 0.2)
    seen = Watched(scene, result.trajectory, tip_of(scene))
    assert seen.end.isclose(aside(tip(scene)), 1e-4, 1e-3)
    there = scene.with_state(JointState(("panda_joint1",), [0.4]))
    named = replace(told("PTP", aside(tip(scene))), goals=(NamedGoal("home"),))
    assert plan(there, named).ok


def test_ptp_goal_already_reached():
    """testJointGoalAlreadyReached: one point."""
    scene = panda()
    for planner in ("PTP", "LIN"):
        result = plan(scene, told(planner, joints(scene)))
        assert result.ok and len(result.trajectory.times) == 1
    assert len(plan(scene, told("LIN", tip(scene))).trajectory.times) == 1


def test_ptp_out_of_limits_or_out_of_reach():
    scene = panda()
    result = plan(scene, told("PTP", joints(scene, 4.0)))
    assert result.code is ErrorCode.GOAL_STATE_INVALID and "panda_joint1" in result.message
    far = plan(scene, told("PTP", tip(scene).shifted(z=2.5)))  # testInvalidCartesianGoal
    assert far.code is ErrorCode.NO_IK_SOLUTION and far.trajectory is None


# --- LIN ---
@pytest.mark.slow
@each_robot
def test_lin_keeps_its_line(robot):
    """checkCartesianLinearity, with MoveIt's tolerance of 1e-6."""
    scene, start = robot(), tip(robot())
    result = plan(scene, told("LIN", aside(start)))
    assert result.ok and result.planner_id == "LIN", result.message
    judge(scene, result.trajectory)
    seen = Watched(scene, result.trajectory, tip_of(scene))
    way = aside(start).translation - start.translation
    share = (seen.points - start.translation) @ way / (way @ way)
    off = seen.points - start.translation - share[:, None] * way
    assert np.linalg.norm(off, axis=1).max() < 1e-6
    assert seen.end.isclose(aside(start), 1e-6, 1e-6)
    total = start.distance_to(aside(start))[1]
    for pose, s in zip(seen.poses[::20], share[::20], strict=True):
        assert pose.distance_to(start.interpolate(aside(start), s))[1] < 1e-6 * total + 1e-6


@pytest.mark.slow
@pytest.mark.cases("limits1-panda", "limits0-ur10")
@each_robot
@pytest.mark.parametrize("limits", [{}, {"max_trans_vel": 0.4, "max_trans_acc": 1.0, "max_trans_dec": -2.0}])
def test_lin_has_a_trapezoid_for_its_speed(robot, limits):
    """cartesianTrapezoidProfile: constant acceleration, constant speed, constant deceleration."""
    scene = robot()
    goal = tip(scene).shifted(y=0.25, z=-0.1)
    result = plan(scene, told("LIN", goal, 0.2, 0.3, parameters=limits))
    assert result.ok, result.message
    full = {"max_trans_vel": 1.0, "max_trans_acc": 2.25, "max_trans_dec": -5.0, **limits}
    v, a, d = 0.2 * full["max_trans_vel"], 0.3 * full["max_trans_acc"], 0.3 * abs(full["max_trans_dec"])
    seen = Watched(scene, result.trajectory, tip_of(scene))
    speed, t = seen.speed, seen.times[:-1] + seen.step / 2
    assert speed.max() == pytest.approx(v, rel=1e-5)
    slope, window = np.diff(speed) / seen.step, 0.032 + seen.step
    end = result.trajectory.duration
    up, down = v / a, v / d

    def inside(low, high):
        return slope[(t[:-1] > low + window) & (t[:-1] < high - window)]

    np.testing.assert_allclose(inside(0.0, up), a, rtol=1e-3)
    np.testing.assert_allclose(inside(up, end - down), 0.0, atol=1e-3)
    np.testing.assert_allclose(inside(end - down, end), -d, rtol=1e-3)
    assert len(inside(0.0, up)) > 10 and len(inside(end - down, end)) > 5
    way = np.linalg.norm(goal.translation - tip(scene).translation)
    assert end == pytest.approx(way / v + (up + down) / 2 + 0.032)


def test_lin_turns_no_faster_than_allowed():
    scene = ur10()
    goal = tip(scene) @ SE3.from_xyz_rpy((0, 0, 0.01), (0, 0, 1.2))
    result = plan(scene, told("LIN", goal, 0.5, 0.5))
    assert result.ok, result.message
    seen = Watched(scene, result.trajectory, tip_of(scene))
    assert seen.turning.max() == pytest.approx(0.5 * 1.57, rel=1e-4)


def test_lin_to_joint_positions_ends_in_them():
    """jointSpaceGoal; a redundant arm is led there on its way."""
    scene = panda()
    goal = joints(scene, 0.4, 0.0, -0.5, 0.0, 0.0, 0.2)
    result = plan(scene, told("LIN", goal))
    assert result.ok, result.message
    np.testing.assert_allclose(result.trajectory.positions[-1], goal.state.positions, atol=1e-6)
    seen = Watched(scene, result.trajectory, tip_of(scene))
    way = seen.end.translation - tip(scene).translation
    off = np.cross(seen.points - tip(scene).translation, way / np.linalg.norm(way))
    assert np.linalg.norm(off, axis=1).max() < 1e-6


def test_lin_does_not_jump_to_another_branch():
    """LinPlannerDiscontinuousJointTraj: the pose is on the line's end, the joints are not."""
    scene = ur10()
    other = tip(scene).shifted(y=0.1)
    from armcell.kinematics import ik_solver

    ik = ik_solver(scene.model, "arm")
    branch = max(
        ik.nearest(other, scene.positions, among=8),
        key=lambda q: float(np.abs(q - scene.positions[ik.columns]).max()),
    )
    goal = JointGoal(JointState(ik.joint_names, branch))
    result = plan(scene.with_padding(0.0), told("LIN", goal))
    assert not result.ok
    if result.code is ErrorCode.PLANNING_FAILED:
        assert "other joint positions" in result.message


def test_a_joint_that_is_too_slow_is_named_with_what_would_do():
    """LinPlannerLimitViolation."""
    scene = panda()
    asked = told("LIN", aside(tip(scene)), 1.0, 1.0)
    result = plan(scene, asked)
    assert result.code is ErrorCode.PLANNING_FAILED and result.trajectory is None
    assert "panda_joint2 would need a" in result.message and result.evidence["slower"] > 1.05
    slower = {k: result.evidence[k] for k in ("velocity_scaling", "acceleration_scaling")}
    again = plan(scene, replace(asked, **slower))
    assert again.ok, again.message
    judge(scene, again.trajectory)
    first = result.explain(60.0).suggestions[0]
    assert first.works and first.text.startswith("move slower")


def test_lin_through_what_cannot_be_reached_stops_there():
    scene = ur10()
    T = tip(scene)
    wrist = scene.model.joint("wrist_3_joint").limits.upper
    there = scene.with_state(JointState(("wrist_3_joint",), [wrist - 0.2]))
    T = tip(there)
    result = plan(there, told("LIN", T @ SE3.from_xyz_rpy((0, 0, 0), (0, 0, 0.9))))
    assert result.code is ErrorCode.NO_IK_SOLUTION
    assert "wrist_3_joint at the limit" in result.message
    assert result.evidence["fraction"] == pytest.approx(0.2 / 0.9, abs=0.07)


# --- CIRC ---
@pytest.mark.slow
@pytest.mark.cases("*-panda")
@each_robot
@pytest.mark.parametrize("kind", ["interim", "center"])
@pytest.mark.parametrize("as_constraint", [False, True])
def test_circ_keeps_its_radius(robot, kind, as_constraint):
    scene, start = robot(), tip(robot())
    center = start.shifted(y=0.12).translation
    goal = start.shifted(0.0, 0.12, -0.12) @ SE3.from_xyz_rpy((0, 0, 0), (0.0, 0.1, 0.3))
    between = center + 0.12 * np.array([0.0, -np.cos(0.7), -np.sin(0.7)])
    point = center if kind == "center" else between
    if as_constraint:  # MoveIt's way
        place = PositionConstraint(((Sphere(0.01), SE3.from_xyz(*point)),), tip_of(scene))
        asked = told("CIRC", goal, path_constraints=Constraints(positions=(place,), name=kind))
    else:
        asked = told("CIRC", goal, parameters={kind: tuple(point)})
    result = plan(scene, asked)
    assert result.ok and result.planner_id == "CIRC", result.message
    judge(scene, result.trajectory)
    seen = Watched(scene, result.trajectory, tip_of(scene))
    radii = np.linalg.norm(seen.points - center, axis=1)
    assert np.abs(radii - 0.12).max() < 1e-6
    assert seen.end.isclose(goal, 1e-6, 1e-6)
    assert np.abs(seen.points[:, 0] - start.translation[0]).max() < 1e-6  # in its plane
    assert np.min(np.linalg.norm(seen.points - between, axis=1)) < 2e-3  # and the shorter way
    assert seen.speed.max() <= 0.3 * 1.0 * (1 + 1e-5)


def test_circ_without_or_with_two_points_is_misuse():
    scene = panda()
    goal, near = tip(scene).shifted(y=0.2), tuple(tip(scene).shifted(y=0.1, z=0.05).translation)
    with pytest.raises(InputError, match="no auxiliary point"):  # emptyAux
        plan(scene, told("CIRC", goal))
    with pytest.raises(InputError, match="interim point and a center"):
        plan(scene, told("CIRC", goal, parameters={"interim": near, "center": near}))
    with pytest.raises(InputError, match="three finite numbers"):
        plan(scene, told("CIRC", goal, parameters={"interim": (0.1, np.nan, 0.2)}))
    place = PositionConstraint(((Sphere(0.01), SE3.from_xyz(*near)),))
    with pytest.raises(InputError, match="named ''"):  # invalidAuxName
        plan(scene, told("CIRC", goal, path_constraints=Constraints(positions=(place,))))
    two = Constraints(positions=(place, place), name="interim")
    with pytest.raises(InputError, match="not one position constraint"):
        plan(scene, told("CIRC", goal, path_constraints=two))
    stranger = Constraints(positions=(replace(place, link="INVALID"),), name="interim")
    with pytest.raises(UnknownNameError, match="INVALID"):  # invalidAuxLinkName
        plan(scene, told("CIRC", goal, path_constraints=stranger))


def test_what_is_no_arc_fails_and_is_explained():
    scene = panda()
    T = tip(scene)
    between = tuple(T.shifted(y=0.1).translation)
    result = plan(scene, told("CIRC", T.shifted(y=0.2), parameters={"interim": between}))
    assert result.code is ErrorCode.INVALID_MOTION_PLAN and "one line" in result.message
    assert any(s.works and s.text == "move by LIN" for s in result.explain(60.0).suggestions)
    beside = tuple(T.shifted(y=0.15).translation)
    result = plan(scene, told("CIRC", T.shifted(y=0.2), parameters={"center": beside}))
    assert result.code is ErrorCode.INVALID_MOTION_PLAN
    assert "150.0 mm from the start and 50.0 mm from the goal" in result.message


# --- all of them ---
def post():
    scene = panda()
    x, _, z = tip(scene).translation
    return scene.with_object(box("post", (0.05, 0.05, 0.5), (x, 0.2, z)))


@pytest.mark.slow
@pytest.mark.parametrize("planner", ["PTP", "LIN", "CIRC"])
def test_what_touches_is_never_returned_and_told_with_pair_and_place(planner):
    scene = post()
    T = tip(scene)
    interim = {"interim": tuple(T.shifted(0.02, 0.2, 0.02).translation)} if planner == "CIRC" else {}
    result = plan(scene, told(planner, T.shifted(y=0.4), parameters=interim))
    assert result.code is ErrorCode.INVALID_MOTION_PLAN
    assert result.trajectory is None and result.path is None
    assert "post" in result.message and "panda_hand_tcp at (" in result.message
    q = result.evidence["positions"]
    from armcell.collision import ExactChecker

    names = scene.model.group("arm").joint_names
    touching = ExactChecker(scene, names).contacts(q)
    assert {(c.body_a, c.body_b) for c in touching} == {
        (c.body_a, c.body_b) for c in result.evidence["contacts"]
    }
    assert min(c.distance for c in touching) > -0.01  # the first contact, not one deep inside
    works = [s.text for s in result.explain(60.0).suggestions if s.works]
    assert any("RRTConnect" in text for text in works)


def test_padding_is_kept():
    scene = panda()
    x, _, z = tip(scene).translation
    beside = box("beside", (0.02, 0.02, 0.02), (x, 0.2, z - 0.012 - 0.01))
    line = told("LIN", tip(scene).shifted(y=0.4))
    assert plan(scene.with_object(beside), line).ok
    result = plan(scene.with_object(beside).with_padding(0.03), line)
    assert result.code is ErrorCode.INVALID_MOTION_PLAN and "beside" in result.message


@pytest.mark.parametrize("planner", ["PTP", "LIN"])
def test_it_begins_at_rest_and_has_one_goal(planner):
    """nonZeroStartVelocity, NotExactlyOneGoalConstraintGiven."""
    scene = panda()
    asked = told(planner, tip(scene).shifted(z=-0.1))
    moving = JointState(("panda_joint2",), [0.0], velocities=[1.0])
    result = plan(scene, replace(asked, start=moving))
    assert result.code is ErrorCode.INVALID_ROBOT_STATE and "panda_joint2" in result.message
    hardly = JointState(("panda_joint1",), [0.0], velocities=[1e-16])
    assert plan(scene, replace(asked, start=hardly)).ok
    result = plan(scene, replace(asked, goals=(*asked.goals, *asked.goals)))
    assert result.code is ErrorCode.INVALID_GOAL_CONSTRAINTS and "exactly one" in result.message
    assert plan(scene, replace(asked, goals=())).code is ErrorCode.INVALID_GOAL_CONSTRAINTS


def test_moveit_s_name_and_names_that_do_not_exist():
    scene = panda()
    asked = told("LIN", tip(scene).shifted(z=-0.1))
    assert plan(scene, replace(asked, pipeline_id="pilz_industrial_motion_planner")).ok
    with pytest.raises(UnknownNameError, match="known: CIRC, LIN, PTP"):
        plan(scene, replace(asked, planner_id="RRTConnect"))
    with pytest.raises(UnknownNameError, match="known: .*native, .*pilz"):
        plan(scene, replace(asked, pipeline_id="pils"))
    with pytest.raises(UnknownNameError, match="max_trans_vel = 1.0"):
        plan(scene, replace(asked, parameters={"max_trans_speed": 1.0}))
    with pytest.raises(UnknownNameError, match="'PTP'.* it has: smoothing = 0.032"):
        plan(scene, replace(asked, planner_id="PTP", parameters={"interim": (0, 0, 0)}))
    for value in (0.0, "fast", True, np.nan):
        with pytest.raises(InputError, match="max_trans_vel"):
            plan(scene, replace(asked, parameters={"max_trans_vel": value}))
    for key in ("torque_limits", "jerk_limits"):
        with pytest.raises(InputError, match=key):
            plan(scene, replace(asked, **{key: True}))
    fixed = Constraints((JointConstraint("panda_joint1", 0.0, 0.1, 0.1),))
    with pytest.raises(InputError, match="no path constraints"):
        plan(scene, replace(asked, path_constraints=fixed))


def test_limits_from_moveit_s_file():
    scene = panda()
    file = {"cartesian_limits": {"max_trans_vel": 0.5, "max_trans_acc": 1.0, "max_trans_dec": -1.0,
                                 "max_rot_vel": 1.57, "max_rot_acc": 3.0}}  # fmt: skip
    asked = told("LIN", tip(scene).shifted(z=-0.2), planner_configs=file)
    result = plan(scene, asked)
    assert result.ok and result.evidence["settings_without_effect"] == ("max_rot_acc",)
    same = plan(scene, replace(asked, planner_configs={}, parameters={
        "max_trans_vel": 0.5, "max_trans_acc": 1.0, "max_trans_dec": 1.0}))  # fmt: skip
    assert same.trajectory.duration == result.trajectory.duration
    assert plan(scene, replace(asked, planner_id="PTP")).ok
    with pytest.raises(InputError, match="cartesian_limits"):
        plan(scene, replace(asked, planner_configs={"planner_configs": {}}))


def test_a_held_object_is_moved_on_the_line():
    scene = panda()
    T = tip(scene)
    scene = scene.with_object(box("bar", (0.02, 0.02, 0.1), T.translation)).with_attached(
        "bar", "panda_hand_tcp", touch_links=("panda_leftfinger", "panda_rightfinger", "panda_hand")
    )
    start = scene.frame_pose("bar")
    goal = start.shifted(y=0.2) @ SE3.from_xyz_rpy((0, 0, 0), (0.2, 0.0, 0.0))
    result = plan(scene, told("LIN", PoseGoal(goal, "bar")))
    assert result.ok, result.message
    names = result.trajectory.joint_names
    for t in np.linspace(0.0, result.trajectory.duration, 40):
        at = scene.with_state(JointState(names, result.trajectory.sample(t)[0])).frame_pose("bar")
        off = at.translation - start.translation
        assert abs(off[0]) < 1e-6 and abs(off[2]) < 1e-6
    assert at.isclose(goal, 1e-5, 1e-5)


@pytest.mark.slow
def test_options_around_it():
    scene = panda()
    goal = tip(scene).shifted(y=0.3)
    slow = plan(scene, told("LIN", goal, max_cartesian_speed=0.05))
    assert Watched(scene, slow.trajectory, tip_of(scene)).speed.max() == pytest.approx(0.05, rel=0.02)
    x, _, z = tip(scene).translation
    inside = ((x - 0.1, -0.1, z - 0.1), (x + 0.1, 0.4, z + 0.1))
    assert plan(scene, told("LIN", goal, workspace=inside)).ok
    bent = tuple(tip(scene).shifted(x=0.15, y=0.15).translation)
    result = plan(scene, told("CIRC", goal, workspace=inside, parameters={"interim": bent}))
    assert result.code is ErrorCode.INVALID_MOTION_PLAN and "workspace" in result.message
    untimed = plan(scene, told("LIN", goal, adapters=("validation",)))
    assert untimed.ok and untimed.trajectory is None and len(untimed.path.waypoints) > 2


def test_a_group_without_a_tip_moves_by_ptp_only():
    scene = panda()
    hand = next(g for g in scene.model.groups.values() if g.tip_link is None)
    q = scene.positions[scene.model.columns(hand.joint_names)]
    goal = JointGoal(JointState(hand.joint_names, q * 0.5 + 0.005))
    asked = PlanRequest(hand.name, (goal,), pipeline_id="pilz", planner_id="PTP")
    assert plan(scene, asked).ok
    with pytest.raises(InputError, match="not a chain"):
        plan(scene, replace(asked, planner_id="LIN"))
