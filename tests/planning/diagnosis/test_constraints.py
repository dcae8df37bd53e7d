"""Explanations of constraints that forbid something, with the real planner: goals, paths, starts.

What is said is compared with pinocchio's view of the same state; what is suggested is planned.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.model.helpers import PinRobot, pin_library
from tests.planning.helpers import down, request
from tests.scene.helpers import DOWN, box, panda

from armcell.core import (
    SE3,
    SO3,
    Box,
    ConstraintGoal,
    Constraints,
    ErrorCode,
    Explanation,
    JointConstraint,
    JointGoal,
    JointState,
    NamedGoal,
    OrientationConstraint,
    PoseGoal,
    PositionConstraint,
    Sphere,
)
from armcell.kinematics import kinematic_tree
from armcell.planning import explain, plan, satisfies_constraints, solve_ik

pytestmark = pytest.mark.slow

TIP = "panda_hand_tcp"


def level(tolerance: float, rotation: SO3 = DOWN) -> Constraints:
    return Constraints(orientations=(OrientationConstraint(rotation, (tolerance, tolerance, np.pi)),))


def explained(scene, asked, code: ErrorCode) -> Explanation:
    """Of the right code; each suggestion that was kept makes the changed request succeed."""
    e = explain(scene, asked, 60.0)
    assert e.code is code, e.text()
    assert e.suggestions, e.text()
    for suggestion in e.suggestions:
        assert suggestion.works is not False
        result = plan(*suggestion.apply(scene, asked))
        assert result.ok, (suggestion.text, result.message)
    return e


def suggestion(e: Explanation, begins: str):
    found = [s for s in e.suggestions if s.text.startswith(begins)]
    assert found, e.text()
    return found[0]


def tilt(scene, wanted: SO3) -> np.ndarray:
    """The tip's rotation from the wanted one, by pinocchio."""
    import pinocchio as pin

    robot = PinRobot(pin_library("panda"), scene.model)
    robot.place(kinematic_tree(scene.model).full_positions(scene.positions))
    return pin.log3(wanted.matrix.T @ robot.pose(TIP)[:3, :3])


@pytest.fixture(scope="module")
def upright():
    """The tip points down, at the right of the Panda."""
    scene = panda()
    q = solve_ik(scene, "arm", down(0.5, -0.25, 0.4)).positions
    return scene.with_state(JointState(scene.model.group("arm").joint_names, q))


def test_a_start_that_violates(upright):
    leaning = DOWN @ SO3.exp((0.0, 0.35, 0.0))
    asked = request(PoseGoal(SE3(leaning, np.array([0.5, 0.2, 0.4]))), path_constraints=level(0.1, leaning))
    e = explained(upright, asked, ErrorCode.START_STATE_VIOLATES_PATH_CONSTRAINTS)
    beyond = np.abs(tilt(upright, leaning)[:2]).max() - 0.1
    assert e.data["violated"]["the orientation of the tip"] == pytest.approx(beyond, abs=1e-6)
    assert f"turned {np.rad2deg(beyond):.2f} deg too far about y" in e.text()
    moved = suggestion(e, "start ").apply(upright, asked)[1]
    there = upright.with_state(moved.start)
    assert np.abs(tilt(there, leaning)[:2]).max() <= 0.1
    assert e.nearest.as_dict() == moved.start.reindexed(e.nearest.joint_names).as_dict()
    wide = suggestion(e, "widen").apply(upright, asked)[1].path_constraints.orientations[0].tolerance
    assert 0.35 <= wide[1] < 0.38 and wide[0] == 0.1  # only about y, and hardly more than it takes
    assert not suggestion(e, "leave out").apply(upright, asked)[1].path_constraints


def test_a_start_and_a_goal_that_violate_differently(upright):
    """The tolerance that is suggested has room for both."""
    goal = PoseGoal(SE3(DOWN @ SO3.exp((0.4, 0.0, 0.0)), np.array([0.5, 0.2, 0.4])))
    leaning = DOWN @ SO3.exp((0.0, 0.3, 0.0))
    asked = request(goal, path_constraints=level(0.1, leaning))
    e = explained(upright, asked, ErrorCode.START_STATE_VIOLATES_PATH_CONSTRAINTS)
    x, y, _ = suggestion(e, "widen").apply(upright, asked)[1].path_constraints.orientations[0].tolerance
    assert 0.35 < x < 0.45 and 0.25 < y < 0.35


def test_a_start_outside_of_a_region_and_of_a_joint_s_range(upright):
    here = upright.frame_pose(TIP).translation
    ball = PositionConstraint(((Sphere(0.1), SE3.from_xyz(*here) @ SE3.from_xyz(0.15, 0.0, 0.0)),))
    at = upright.state["panda_joint1"]
    corridor = JointConstraint("panda_joint1", at + 0.3, 0.1, 0.2)
    goal = PoseGoal(SE3.from_xyz(0.12, 0.0, 0.0) @ SE3(DOWN, here))
    asked = request(goal, path_constraints=Constraints((corridor,), (ball,)))
    e = explained(upright, asked, ErrorCode.START_STATE_VIOLATES_PATH_CONSTRAINTS)
    assert e.data["violated"]["the position of the tip"] == pytest.approx(0.05, abs=1e-6)
    assert e.data["violated"]["panda_joint1"] == pytest.approx(0.1, abs=1e-9)
    wide = suggestion(e, "widen").apply(upright, asked)[1].path_constraints
    assert satisfies_constraints(upright, "arm", wide, upright.state.reindexed(e.state.joint_names).positions)
    assert wide.positions[0].region[0][0].radius < 0.16 and wide.joints[0].tolerance_above == 0.1


@pytest.mark.parametrize("kind", ["pose", "joints", "constraints"])
def test_a_goal_that_violates(upright, kind):
    turned = SE3(DOWN @ SO3.exp((0.5, 0.0, 0.0)), np.array([0.5, 0.2, 0.4]))
    names = upright.model.group("arm").joint_names
    goal = {
        "pose": lambda: PoseGoal(turned),
        "joints": lambda: JointGoal(JointState(names, solve_ik(upright, "arm", turned).positions)),
        "constraints": lambda: ConstraintGoal(level(0.05, turned.rotation)),
    }[kind]()
    asked = request(goal, path_constraints=level(0.2))
    e = explained(upright, asked, ErrorCode.GOAL_VIOLATES_PATH_CONSTRAINTS)
    if kind != "constraints":  # a region's nearest state is less than its middle away
        assert e.data["violated"]["the orientation of the tip"] == pytest.approx(0.3, abs=2e-3)
    assert "about x" in e.text() and e.summary.startswith("goal violates")
    near = suggestion(e, "change the goal" if kind != "pose" else "take the pose")
    result = plan(*near.apply(upright, asked))
    end = upright.with_state(JointState(names, result.trajectory.positions[-1]))
    assert np.abs(tilt(end, DOWN)[:2]).max() <= 0.2 + 1e-6
    if kind == "pose":
        changed = near.apply(upright, asked)[1].goals[0].T_world_link
        assert turned.distance_to(changed)[0] < 0.15 and turned.distance_to(changed)[1] > 0.25


def test_a_motion_that_constraints_forbid_is_found_to_be_theirs():
    """The tip in a tube that a wall closes: without the tube it goes around."""
    scene = panda(box("wall", (0.3, 0.02, 0.5), (0.5, 0.0, 0.4)))
    at = solve_ik(scene, "arm", down(0.5, -0.25, 0.4)).positions
    scene = scene.with_state(JointState(scene.model.group("arm").joint_names, at))
    tube = PositionConstraint(((Box(0.2, 0.7, 0.2), SE3.from_xyz(0.5, 0.0, 0.4)),))
    asked = request(
        PoseGoal(down(0.5, 0.25, 0.4)), path_constraints=Constraints((), (tube,), level(0.5).orientations),
        planning_time=1.0,
    )  # fmt: skip
    e = explained(scene, asked, ErrorCode.TIMED_OUT)
    assert "without the constraint on the position of the tip it works" in e.text()
    grown = suggestion(e, "widen the tolerance of the position").apply(scene, asked)[1]
    assert grown.path_constraints.positions[0].region[0][0].y > 0.7
    assert grown.path_constraints.orientations == asked.path_constraints.orientations
    assert not suggestion(e, "leave out").apply(scene, asked)[1].path_constraints.positions


# --- constraint goals ---
def test_a_constraint_goal_inside_an_object():
    """A small region in a box: with a larger one, or none, there are free states."""
    scene = panda(box("crate", (0.2, 0.2, 0.2), (0.5, 0.2, 0.3)))
    inside = PositionConstraint(((Sphere(0.05), SE3.from_xyz(0.5, 0.2, 0.3)),))
    goal = ConstraintGoal(Constraints(positions=(inside,), orientations=level(0.1).orientations))
    e = explained(scene, request(goal), ErrorCode.GOAL_IN_COLLISION)
    assert "without the constraint on the position of the tip it works" in e.text()
    assert "crate" in e.text()
    changed = suggestion(e, "widen the tolerance of the position").apply(scene, request(goal))[1]
    assert changed.goals[0].constraints.positions[0].region[0][0].radius > 0.05


def test_a_constraint_goal_that_contradicts_itself():
    apart = tuple(OrientationConstraint(DOWN @ SO3.exp((x, 0.0, 0.0)), (0.1, 0.1, 0.1)) for x in (0.0, 0.5))
    goal = ConstraintGoal(Constraints(orientations=apart))
    e = explained(panda(), request(goal), ErrorCode.INVALID_GOAL_CONSTRAINTS)
    assert "deg apart" in e.text()
    told = [s.text for s in e.suggestions]
    assert len(set(told)) == len(told)  # the two are told apart
    for number in (1, 2):
        suggestion(e, f"leave out the constraint on the orientation of the tip (number {number})")
    assert any(text.startswith("widen the tolerance of the orientation of the tip (num") for text in told)


def test_a_constraint_goal_of_one_joint_beyond_its_limits():
    model = panda().model
    beyond = JointConstraint("panda_joint1", model.joint("panda_joint1").limits.upper + 0.3, 0.1, 0.1)
    goal = ConstraintGoal(Constraints(joints=(beyond,)))
    e = explained(panda(), request(goal), ErrorCode.INVALID_GOAL_CONSTRAINTS)
    assert "no position of joint panda_joint1" in e.text()
    wide = suggestion(e, "widen the tolerance of panda_joint1").apply(panda(), request(goal))[1]
    assert wide.goals[0].constraints.joints[0].tolerance_below == pytest.approx(0.4)


def test_what_is_given_stays_as_it_was(upright):
    asked = request(NamedGoal("extended"), path_constraints=level(0.2))
    before = (replace(asked), upright.positions.copy())
    explain(upright, asked)
    assert asked.path_constraints is before[0].path_constraints and asked.goals == before[0].goals
    np.testing.assert_array_equal(upright.positions, before[1])
