"""What stops a line, told with place and cause; spare joints, path constraints, jumps, offsets."""

from __future__ import annotations

import numpy as np
import pytest
from tests.planning.cartesian.test_plan import run, tip
from tests.planning.helpers import judge
from tests.scene.helpers import box, panda, ur10
from tests.timing.helpers import distance_to_polyline

from armcell.collision import ExactChecker
from armcell.core import (
    SE3,
    SO3,
    Box,
    CartesianRequest,
    Constraints,
    ErrorCode,
    InputError,
    JointConstraint,
    JointState,
    OrientationConstraint,
    PositionConstraint,
    UnknownNameError,
)
from armcell.kinematics import ik_solver, kinematic_tree
from armcell.planning import constraint_errors, plan, plan_cartesian, waypoints_by_offsets
from armcell.planning.diagnosis.changes import replace_by_free_motion

ARM = tuple(f"panda_joint{k}" for k in range(1, 8))


def at(scene, q):
    return scene.with_state(JointState(scene.model.group("arm").joint_names, q))


# --- spare joints ---
HARD = {  # found among random lines: start, offset [m], turn [rad]
    "limit": ((-2.24, 0.22, 1.54, -0.88, -1.41, 3.12, 1.27), (-0.11, 0.32, -0.13), (-0.15, -0.05, -0.27)),
    "itself": ((-0.12, 0.46, -1.07, -2.75, 1.95, 0.5, -0.05), (-0.07, -0.02, -0.11), (-0.07, 0.21, -0.38)),
    "elbow": ((1.34, 0.36, -0.75, -1.11, 0.21, 0.33, 1.42), (-0.32, -0.12, -0.02), (0.11, -0.04, 0.04)),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", HARD)
def test_the_spare_joint_completes_what_a_plain_descent_cannot(case):
    q, offset, turn = HARD[case]
    scene = at(panda(), q)
    start = tip(scene)
    goal = SE3(SO3.exp(turn) @ start.rotation, start.translation + offset)
    # The plain descent, from pose to pose, as a reference: it ends at a limit, jumps or collides.
    exact = ExactChecker(scene, ARM)
    ik, full, reached = ik_solver(scene.model, "arm"), scene.positions.copy(), 0
    count = int(np.ceil(max(np.linalg.norm(offset) / 0.005, np.linalg.norm(turn) / 0.05)))
    for k in range(count):
        before = full.copy()
        ok = ik.descend(full, start.interpolate(goal, (k + 1) / count))[2]
        if not ok or np.max(np.abs(full - before)) > 0.2 or not exact.is_free(full[: len(ARM)]):
            break
        reached += 1
    assert reached < count
    result = run(scene, goal)
    assert result.ok and result.fraction == 1.0, result.message
    judge(scene, result.trajectory)
    assert np.max(np.abs(np.diff(result.path.waypoints, axis=0))) <= 0.2
    poses = [tip(at(scene, p)) for p in result.path.waypoints]
    line = np.array([start.translation, goal.translation])
    assert distance_to_polyline(np.array([p.translation for p in poses]), line).max() <= 1e-5
    assert poses[-1].isclose(goal, 1e-5, 1e-4)


def test_joints_near_their_limits_are_led_away_from_them():
    scene = panda(joint7=2.8)
    result = run(scene, tip(scene).shifted(z=-0.2))
    assert result.ok
    upper = scene.model.joint("panda_joint7").limits.upper
    margins = upper - result.path.waypoints[:, 6]
    assert margins[-1] > margins[0] + 0.05


# --- place and cause ---
def stops():
    T, UT = tip(panda()), tip(ur10())
    plate = box("plate", (0.3, 0.3, 0.02), T.translation - (0, 0, 0.2))
    wrist = ur10()
    wrist = wrist.with_state(
        JointState(("wrist_3_joint",), [wrist.model.joint("wrist_3_joint").limits.upper - 0.2])
    )
    turned = SE3(UT.rotation @ SO3.from_rpy((0, 0, 0.9)), UT.translation)
    upright = Constraints(orientations=(OrientationConstraint(UT.rotation, (0.3, 0.3, 0.3)),))
    return {
        "collision": (panda(plate), T.shifted(z=-0.3), {}, ErrorCode.INVALID_MOTION_PLAN),
        "joint limit": (wrist, SE3(tip(wrist).rotation @ SO3.from_rpy((0, 0, 0.9)), UT.translation), {},
                        ErrorCode.NO_IK_SOLUTION),
        "out of reach": (ur10(), UT.shifted(x=1.5), {}, ErrorCode.NO_IK_SOLUTION),
        "jump": (panda(), T.shifted(z=-0.2), {"jump_threshold": 1e-3}, ErrorCode.PLANNING_FAILED),
        "path constraint": (ur10(), turned, {"path_constraints": upright}, ErrorCode.INVALID_MOTION_PLAN),
    }  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("cause", ["collision", "joint limit", "out of reach", "jump", "path constraint"])
def test_a_stop_tells_its_place_and_cause(cause):
    scene, goal, options, code = stops()[cause]
    result = run(scene, goal, **options)
    assert result.code is code and result.evidence["cause"] == cause
    assert 0.0 <= result.fraction < 1.0
    names = scene.model.group("arm").joint_names
    last = scene.positions[scene.model.columns(names)]
    if result.path is not None:
        last = result.path.waypoints[-1]
    np.testing.assert_array_equal(result.evidence["positions"], last)
    full = scene.positions.copy()
    full[scene.model.columns(names)] = last
    link = scene.model.group("arm").tip_link
    assert result.evidence["stops_at"].isclose(kinematic_tree(scene.model).link_pose(full, link))
    assert result.evidence["waypoint"] == 1
    wanted = tip(scene).interpolate(goal, result.fraction)
    assert result.evidence["stops_at"].isclose(wanted, 1e-4, 1e-3)


def test_a_stop_names_the_waypoint_it_was_on_the_way_to():
    T = tip(panda())
    plate = box("plate", (0.3, 0.3, 0.02), T.shifted(y=0.2, z=-0.2).translation)
    result = run(panda(plate), T.shifted(y=0.2), T.shifted(y=0.2, z=-0.3), T)
    assert result.evidence["cause"] == "collision" and result.evidence["waypoint"] == 2


@pytest.mark.slow
def test_a_start_in_collision_is_called_so():
    start = tip(panda())
    scene = panda(box("block", (0.1, 0.1, 0.1), start.translation))
    result = run(scene, start.shifted(z=0.1))
    assert result.code is ErrorCode.START_STATE_IN_COLLISION and result.fraction == 0.0
    assert result.path is None and "block" in result.message
    assert "block" in result.explain(60.0).text()
    assert run(scene, start.shifted(z=0.1), avoid_collisions=False).ok


# --- path constraints ---
def test_a_corridor_of_a_joint_is_kept_by_the_others():
    """Without it the elbow swings; with it the spare joint does without."""
    scene = panda()
    goal = tip(scene).shifted(y=0.25, z=-0.1)
    free = run(scene, goal)
    moved = np.ptp(free.path.waypoints[:, 2])
    assert moved > 0.05
    corridor = Constraints(joints=(JointConstraint("panda_joint3", 0.0, 0.02, 0.02),))
    result = run(scene, goal, path_constraints=corridor)
    assert result.ok, result.message
    judge(scene, result.trajectory)
    for t in np.linspace(0, result.trajectory.duration, 300):
        assert abs(result.trajectory.sample(t)[0][2]) <= 0.02 + 1e-4
    poses = tip(at(scene, result.path.waypoints[-1]))
    assert poses.isclose(goal, 1e-5, 1e-4)


@pytest.mark.slow
def test_a_constraint_that_stops_it_is_named_and_its_widening_helps():
    scene, goal, options, _ = stops()["path constraint"]
    request = CartesianRequest("arm", (goal,), **options)
    result = plan_cartesian(scene, request)
    assert 0.25 < result.fraction < 0.34  # 0.3 of 0.9 rad
    link = scene.model.group("arm").tip_link
    assert link in result.message and result.evidence["constraints"] == [link]
    for t in np.linspace(0, result.trajectory.duration, 50):
        errors = constraint_errors(scene, "arm", request.path_constraints, result.trajectory.sample(t)[0])
        assert all(np.max(e.excess) <= 2e-4 for e in errors)
    explanation = result.explain(60.0)
    useful = [s for s in explanation.suggestions if "constraint" in s.text or "widen" in s.text]
    assert useful
    changed_scene, changed = useful[0].apply(scene, request)
    assert plan_cartesian(changed_scene, changed).ok


@pytest.mark.slow
def test_a_start_outside_of_the_constraints_is_called_so():
    scene = panda()
    away = PositionConstraint(((Box(0.1, 0.1, 0.1), SE3.from_xyz(2.0, 0.0, 0.0)),))
    result = run(scene, tip(scene).shifted(z=-0.1), path_constraints=Constraints(positions=(away,)))
    assert result.code is ErrorCode.START_STATE_VIOLATES_PATH_CONSTRAINTS and result.fraction == 0.0
    assert "outside" in result.explain(60.0).text()


def test_constraints_that_cannot_be_meant_raise():
    wrong = Constraints(joints=(JointConstraint("panda_joint9", 0.0, 0.1, 0.1),))
    with pytest.raises(UnknownNameError, match="panda_joint9"):
        run(panda(), tip(panda()).shifted(z=-0.1), path_constraints=wrong)


# --- jumps ---
def test_a_relative_jump_is_told_from_the_mean_step():
    """Near a stretched elbow the steps of the joints grow; checked on the same line without threshold."""
    scene = ur10()
    goal = tip(scene).shifted(x=1.5)
    steps = np.abs(np.diff(run(scene, goal, jump_threshold=0.0).path.waypoints, axis=0)).sum(axis=1)
    factor = 0.5 * (1.0 + steps.max() / steps.mean())
    first = int(np.argmax(steps > factor * steps.mean()))
    result = run(scene, goal, jump_threshold=0.0, relative_jump_threshold=factor)
    assert result.evidence["cause"] == "jump" and result.evidence["field"] == "relative_jump_threshold"
    assert len(result.path.waypoints) == first + 1
    assert result.evidence["joint"] in scene.model.group("arm").joint_names


def test_a_relative_threshold_makes_at_least_ten_steps():
    scene = panda()
    result = run(scene, tip(scene).shifted(z=-0.01), relative_jump_threshold=5.0)
    assert result.ok and len(result.path.waypoints) == 11


@pytest.mark.parametrize("name", ["jump_threshold", "prismatic_jump_threshold", "relative_jump_threshold"])
@pytest.mark.parametrize("value", [-0.1, np.nan])
def test_thresholds_are_not_below_zero(name, value):
    with pytest.raises(InputError, match=name):
        run(panda(), tip(panda()).shifted(z=-0.1), **{name: value})


# --- offsets ---
def test_offsets_add_up_in_the_link_s_axes_or_a_frame_s():
    scene = panda()
    T = tip(scene)
    down = SE3.from_xyz(0.0, 0.0, 0.1)
    turn = SE3.from_xyz_rpy((0.0, 0.0, 0.0), (0.0, 0.0, 0.3))
    own = waypoints_by_offsets(scene, "arm", (down, turn, down))
    assert own[0].isclose(T @ down) and own[2].isclose(T @ down @ turn @ down)
    world = waypoints_by_offsets(scene, "arm", (down, turn), frame="world")
    assert world[0].isclose(T.shifted(z=0.1))
    np.testing.assert_allclose(world[1].rotation.matrix, (SO3.from_rpy((0, 0, 0.3)) @ T.rotation).matrix)
    np.testing.assert_allclose(world[1].translation, world[0].translation)
    assert run(scene, *own).ok
    with pytest.raises(UnknownNameError):
        waypoints_by_offsets(scene, "arm", (down,), frame="nowhere")


def test_a_line_that_stops_can_be_gone_freely():
    """The suggestion of last resort: a free motion to the last waypoint, path constraints kept."""
    scene = panda()
    goal = tip(scene).shifted(y=0.25, z=-0.1)
    corridor = Constraints(joints=(JointConstraint("panda_joint3", 0.0, 0.3, 0.3),))
    _, request = replace_by_free_motion(scene, CartesianRequest("arm", (goal,), path_constraints=corridor))
    result = plan(scene, request)
    assert result.ok and np.max(np.abs(result.trajectory.positions[:, 2])) <= 0.3 + 1e-4
