"""PlanningSession without a browser: goals, settings, plans, executions, suggestions, the scene, files."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest
from tests.scene.helpers import box

from armcell.cell import load
from armcell.collision import ExactChecker
from armcell.core import SE3, ErrorCode, InputError, JointGoal, JointState, PoseGoal, UnknownNameError
from armcell.kinematics import kinematic_tree
from armcell.viewer import PlanningSession, scene_edits
from armcell.viewer.session_goal import FREE, LINE, MOTIONS, UPRIGHT

DOWN = (np.pi, 0.0, 0.0)
ABOVE_TRAY = SE3.from_xyz_rpy((0.5, 0.25, 0.3), DOWN)
IN_WALL = SE3.from_xyz_rpy((0.55, 0.06, 0.2), DOWN)
FAR = SE3.from_xyz_rpy((1.5, 0.0, 0.4), DOWN)


@pytest.fixture(scope="module")
def cell():
    return load("panda_pick")


@pytest.fixture
def session(cell):
    session = PlanningSession(
        cell.scene(), lambda scene, observers: cell.connect("fake", observers=observers, scene=scene)
    )
    yield session
    session.close()


def tip(session, q):
    return kinematic_tree(session.scene.model).link_pose(q, session.tip_link)


def planned(session):
    session.plan()
    assert session.wait(90), "planning took too long"
    return session.result


# --- goals ---
def test_a_pose_that_can_be_reached_is_free_and_there(session):
    session.set_goal_pose(ABOVE_TRAY)
    assert session.goal.status == "free"
    assert tip(session, session.goal.positions).isclose(ABOVE_TRAY, 1e-4, 1e-4)
    checker = ExactChecker(session.scene, session.joint_names)
    assert checker.is_free(session.goal.positions[checker.columns])


def test_a_pose_in_the_wall_names_the_pair(session):
    session.set_goal_pose(IN_WALL)
    assert session.goal.status == "collision" and "touches wall" in session.goal.text
    checker = ExactChecker(session.scene, session.joint_names)
    expected = {
        frozenset((c.body_a, c.body_b)) for c in checker.contacts(session.goal.positions[checker.columns])
    }
    assert {frozenset((c.body_a, c.body_b)) for c in session.goal.contacts} == expected


def test_a_pose_too_far_off_says_how_far(session):
    session.set_goal_pose(FAR)
    assert session.goal.status == "out of reach"
    missing = tip(session, session.goal.positions).distance_to(FAR)[0]
    assert f"{missing * 1000:.0f} mm" in session.goal.text and missing > 0.3


def test_named_random_and_present_states(session):
    session.set_named("extended")
    extended = session.scene.model.named_state("arm", "extended")
    assert np.allclose(session.goal.positions[:7], extended.positions)
    session.set_random()
    assert session.goal.status == "free" and not np.allclose(session.goal.positions[:7], extended.positions)
    session.set_random(start=True)
    assert session.start is not None
    session.set_current_state(start=True)
    session.set_current_state()
    assert session.start is None and np.array_equal(session.goal.positions, session.scene.positions)


def test_what_cannot_be_changes_nothing(session):
    goal, settings = session.goal, session.settings
    for wrong in (
        lambda: session.set_named("nowhere"),
        lambda: session.set_positions(JointState(("panda_joint1",), np.array([9.0]))),
        lambda: session.change_settings(planner="NoSuch"),
        lambda: session.change_settings(velocity_scaling=1.5),
        lambda: session.change_settings(attempts=0),
        lambda: session.change_settings(motion="teleport"),
        lambda: session.set_group("legs"),
    ):
        with pytest.raises(InputError):
            wrong()
    assert session.goal is goal and session.settings is settings and session.group == "arm"


# --- requests ---
def test_the_request_is_what_was_chosen(session):
    session.set_goal_pose(ABOVE_TRAY)
    session.change_settings(
        pipeline="ompl", planner="BITstar", planning_time=2.0, attempts=3, velocity_scaling=0.5
    )
    request = session.request()
    assert (request.pipeline_id, request.planner_id, request.planning_time) == ("ompl", "BITstar", 2.0)
    assert (request.attempts, request.velocity_scaling) == (3, 0.5)
    assert isinstance(request.goals[0], JointGoal)  # the robot that is shown
    session.set_goal_pose(IN_WALL)
    assert isinstance(session.request().goals[0], PoseGoal)  # so that the pose is explained


def test_the_gripper_has_no_tip(session):
    session.set_group("hand")
    assert session.goal.T_world_tip is None
    session.change_settings(motion=LINE)
    with pytest.raises(InputError, match="no tip"):
        session.request()
    session.change_settings(motion=FREE)
    session.set_named("closed")
    assert planned(session).ok


@pytest.mark.parametrize(
    "motion", [pytest.param(m, marks=pytest.mark.slow) if m == UPRIGHT else m for m in MOTIONS]
)
def test_each_kind_of_motion_is_one(session, motion):
    session.change_settings(motion=motion)
    session.set_goal_pose(SE3.from_xyz_rpy((0.45, -0.25, 0.45), DOWN))
    result = planned(session)
    assert result.ok, session.message
    tips = [tip(session, session.positions_at(t)) for t in np.linspace(0, result.trajectory.duration, 60)]
    assert tips[-1].isclose(session.goal.T_world_tip, 1e-3, 1e-3)
    if motion == LINE:
        along = (tips[-1].translation - tips[0].translation) / np.linalg.norm(
            tips[-1].translation - tips[0].translation
        )
        for T in tips:
            way = T.translation - tips[0].translation
            assert np.linalg.norm(way - (way @ along) * along) < 2e-3
    if motion == UPRIGHT:
        tilt = [np.arccos(np.clip(-T.rotation.matrix[2, 2], -1, 1)) for T in tips]
        assert max(tilt) < np.deg2rad(10.0 * np.sqrt(2) + 0.1)


# --- planning and executing ---
def test_plan_execute_and_the_second_execution_is_refused(session):
    assert session.why_not_executable == "there is no plan"
    with pytest.raises(InputError, match="there is no plan"):
        session.execute()
    session.set_goal_pose(ABOVE_TRAY)
    assert planned(session).ok and session.why_not_executable == ""
    session.execute()
    assert session.wait(60) and session.outcome.ok, session.message
    assert tip(session, session.scene.positions).isclose(ABOVE_TRAY, 1e-3, 1e-3)
    with pytest.raises(InputError, match="where the robot is"):
        session.execute()


def test_a_plan_from_elsewhere_or_of_another_scene_is_not_executed(session):
    session.set_named("extended", start=True)
    session.set_goal_pose(ABOVE_TRAY)
    assert planned(session).ok and "where the robot is" in session.why_not_executable
    session.set_current_state(start=True)
    assert planned(session).ok and session.why_not_executable == ""
    session.change_scene(lambda now: now.without_object("post"))
    assert "scene was changed" in session.why_not_executable


def test_the_live_cell_is_made_anew_when_the_world_was_changed(session):
    session.set_goal_pose(ABOVE_TRAY)
    planned(session)
    session.execute()
    assert session.wait(60) and session.outcome.ok
    session.change_scene(lambda now: now.with_object(box("new", (0.1, 0.1, 0.1), (-0.5, 0.0, 0.5))))
    session.set_named("home")
    planned(session)
    session.execute()
    assert session.wait(60) and session.outcome.ok and "new" in session.scene.objects


def test_executed_in_physics(cell):
    session = PlanningSession(cell.scene(), lambda s, o: cell.connect("sim", observers=o, scene=s))
    session.set_goal_pose(ABOVE_TRAY)
    assert planned(session).ok
    session.execute()
    assert session.wait(90) and session.outcome.ok, session.message
    assert tip(session, session.scene.positions).isclose(ABOVE_TRAY, 5e-3, 1e-2)
    cube = session.scene.objects["cube"].T_world_object.translation  # settled on the table, not where drawn
    assert not np.array_equal(cube, cell.scene().objects["cube"].T_world_object.translation)
    assert np.allclose(cube, cell.scene().objects["cube"].T_world_object.translation, atol=5e-3)
    session.close()


def test_physics_refuses_what_is_attached_by_hand(cell):
    session = PlanningSession(cell.scene(), lambda s, o: cell.connect("sim", observers=o, scene=s))
    session.change_scene(
        lambda now: scene_edits.with_new(now, "tool", "sphere", (0.02,), SE3.from_xyz(0.307, 0, 0.45))
    )
    session.change_scene(lambda now: scene_edits.with_attached(now, "tool", session.tip_link))
    session.set_goal_pose(ABOVE_TRAY)
    assert planned(session).ok, session.message
    session.execute()
    session.wait(60)
    assert "detach" in session.message and session.outcome is None
    session.close()


def test_stop_ends_planning_at_once_and_errors_are_said(session, monkeypatch):
    begun = threading.Event()

    def for_ever(scene, request, cancel):
        begun.set()
        assert cancel.wait(30)
        raise RuntimeError("broken inside")

    monkeypatch.setattr("armcell.viewer.planning_session.plan", for_ever)
    session.plan()
    assert begun.wait(10) and session.busy == "planning"
    with pytest.raises(InputError, match="planning"):
        session.plan()
    session.stop()
    assert session.wait(10)
    assert session.message == "internal error: RuntimeError: broken inside"
    monkeypatch.undo()
    session.set_goal_pose(ABOVE_TRAY)
    assert planned(session).ok


def test_stop_while_the_robot_moves(cell):
    connect = lambda s, o: cell.connect("fake", observers=o, time_scale=1.0, scene=s)  # noqa: E731
    session = PlanningSession(cell.scene(), connect)
    session.change_settings(velocity_scaling=0.1)
    session.set_goal_pose(ABOVE_TRAY)
    assert planned(session).ok
    duration = session.result.trajectory.duration
    began = time.monotonic()
    session.execute()
    time.sleep(1.0)
    with pytest.raises(InputError, match="the robot moves"):
        session.change_scene(lambda now: now.without_object("post"))
    session.stop()
    assert session.wait(10) and time.monotonic() - began < duration - 1.0
    assert session.outcome.code is ErrorCode.PREEMPTED
    assert not np.allclose(session.scene.positions, session.goal.positions, atol=0.05)
    session.close()
    assert not [t for t in threading.enumerate() if t.name.startswith("armcell-ex")]


# --- why not, and what helps ---
def test_a_suggestion_applied_succeeds(session):
    session.set_goal_pose(IN_WALL)
    result = planned(session)
    assert result.code is ErrorCode.GOAL_IN_COLLISION
    suggestions = session.explanation.suggestions
    moved = next(s for s in suggestions if s.text.startswith("move the goal"))
    session.apply(moved)
    assert session.explanation is None and session.goal.status == "free"
    assert planned(session).ok
    end = tip(session, session.positions_at(session.result.trajectory.duration))
    assert end.isclose(session.goal.T_world_tip, 1e-3, 1e-2)


def test_a_suggestion_about_the_scene_changes_the_scene(session):
    session.set_goal_pose(IN_WALL)
    planned(session)
    session.apply(next(s for s in session.explanation.suggestions if "take wall away" in s.text))
    assert "wall" not in session.scene.objects and planned(session).ok


def test_misuse_is_explained_too(session):
    session.set_goal_pose(FAR)
    planned(session)
    assert session.explanation.code is ErrorCode.NO_IK_SOLUTION and session.explanation.suggestions


# --- the scene ---
def test_objects_come_move_are_held_and_go(session):
    at = SE3.from_xyz(0.5, 0.0, 0.8)
    name = scene_edits.free_name(session.scene, "cylinder")
    session.change_scene(lambda now: scene_edits.with_new(now, name, "cylinder", (0.03, 0.2), at))
    assert name == "cylinder_1" and scene_edits.free_name(session.scene, "cylinder") == "cylinder_2"
    session.change_scene(lambda now: scene_edits.with_attached(now, name, session.tip_link))
    assert session.scene.attached[name].link == session.tip_link
    session.change_scene(lambda now: now.with_detached(name))
    assert session.scene.objects[name].T_world_object.isclose(at, 1e-9, 1e-9)
    session.change_scene(lambda now: now.without_object(name))
    assert name not in session.scene.objects


def test_an_object_put_into_the_goal_makes_it_red_and_allowing_it_green(session):
    session.set_goal_pose(ABOVE_TRAY)
    session.change_scene(lambda now: scene_edits.with_new(now, "block", "box", (0.12,) * 3, ABOVE_TRAY))
    assert session.goal.status == "collision" and "block" in session.goal.text
    touching = {n for c in session.goal.contacts for n in (c.body_a, c.body_b)} - {"block"}
    solid = scene_edits.other_bodies(session.scene, "block")
    assert touching <= set(solid) and "wall" not in solid
    session.change_scene(lambda now: now.with_allowed("block", solid))
    assert session.goal.status == "free"


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (("wall", "box", (0.1, 0.1, 0.1)), "already"),
        (("panda_hand", "box", (0.1, 0.1, 0.1)), "already"),
        ((" ", "box", (0.1, 0.1, 0.1)), "needs a name"),
        (("a", "teapot", (0.1,)), "no shape"),
        (("a", "box", (0.1, -0.1, 0.1)), "box"),
    ],
)
def test_objects_that_cannot_be(session, arguments, why):
    before = session.scene
    with pytest.raises(InputError, match=why):
        session.change_scene(lambda now: scene_edits.with_new(now, *arguments, SE3.identity()))
    assert session.scene is before


@pytest.mark.parametrize("file", ["mine.scene", "mine.yaml"])
def test_saved_and_loaded_again(session, cell, tmp_path, file):
    ours = set()
    scene_edits.save(session.scene, file, tmp_path, ours)
    scene_edits.save(session.scene, file, tmp_path, ours)  # its own file may be written again
    with pytest.raises(InputError, match="was not written here"):
        scene_edits.save(session.scene, file, tmp_path, set())
    empty = session.scene
    for name in session.scene.objects:
        empty = empty.without_object(name)
    again = scene_edits.with_loaded(empty, file, tmp_path)
    assert list(again.objects) == list(session.scene.objects)
    for name, item in again.objects.items():
        before = session.scene.objects[name]
        assert item.T_world_object.isclose(before.T_world_object, 1e-9, 1e-9)
        assert [s for s, _ in item.shapes] == [s for s, _ in before.shapes]


@pytest.mark.parametrize(
    "file", ["../mine.yaml", "/tmp/mine.yaml", "mine.py", ".mine.yaml", "", "absent.yaml"]
)
def test_files_elsewhere_are_refused(session, tmp_path, file):
    with pytest.raises(InputError):
        scene_edits.with_loaded(session.scene, file, tmp_path)
    if file != "absent.yaml":
        with pytest.raises(InputError):
            scene_edits.save(session.scene, file, tmp_path, set())


def test_unknown_group_lists_those_there_are(session):
    with pytest.raises(UnknownNameError, match="hand"):
        session.set_group("legs")
