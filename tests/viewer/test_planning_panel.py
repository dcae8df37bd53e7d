"""The planning panel through viser's handles: each widget does its work and shows what is true."""

from __future__ import annotations

import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

from armcell.cell import load
from armcell.core import SE3
from armcell.kinematics import kinematic_tree
from armcell.planning import pipelines
from armcell.viewer import PlanningPanel, PlanningSession
from armcell.viewer.motion_preview import GREY

DOWN = (np.pi, 0.0, 0.0)


@pytest.fixture(scope="module")
def cell():
    return load("panda_pick")


@pytest.fixture
def panel(cell, tmp_path):
    session = PlanningSession(
        cell.scene(), lambda scene, observers: cell.connect("fake", observers=observers, scene=scene)
    )
    with PlanningPanel(session, port=0, folder=tmp_path) as panel:
        yield panel


def until(condition, timeout=120.0):
    end = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < end, "did not happen in time"
        time.sleep(0.01)


def drag(control, T):
    """As the browser does: the control moves, then its callbacks are called."""
    control.position, control.wxyz = T.translation, T.quat_wxyz
    for callback in control._impl_aux.update_cb:
        callback(SimpleNamespace(target=control, phase="update"))


def pose(handle):
    return SE3.from_quat_wxyz(handle.position, handle.wxyz)


def click(button):
    button.value = True


@pytest.mark.slow
def test_the_ghost_follows_the_control_and_the_last_of_many_drags_counts(panel):
    for y in np.linspace(0.0, 0.25, 100):
        drag(panel.goal_control, SE3.from_xyz_rpy((0.45, y, 0.35), DOWN))
    wanted = SE3.from_xyz_rpy((0.45, 0.25, 0.35), DOWN)
    until(lambda: panel.session.goal.T_world_tip.isclose(wanted, 1e-6, 1e-6))
    until(lambda: panel.goal_ghost.root.visible)
    tree, q = kinematic_tree(panel.session.scene.model), panel.session.goal.positions
    until(
        lambda: pose(panel.goal_ghost._frames["panda_hand"]).isclose(
            tree.link_pose(q, "panda_hand"), 1e-5, 1e-5
        )
    )
    assert tree.link_pose(q, "panda_hand_tcp").isclose(wanted, 1e-4, 1e-4)
    assert not panel.goal_ghost._frames["panda_link0"].visible  # which does not move
    assert "Goal free" in panel.plan.goal.content and pose(panel.goal_control).isclose(wanted, 1e-6, 1e-6)


@pytest.mark.slow
def test_red_with_the_pair_and_grey_with_the_distance(panel):
    drag(panel.goal_control, SE3.from_xyz_rpy((0.55, 0.06, 0.2), DOWN))
    until(lambda: "panda_hand touches wall" in panel.plan.goal.content)
    until(lambda: panel.label.visible and "panda_hand touches wall" in panel.label.text)
    red, green, _ = panel.goal_ghost._parts["panda_hand"][0].color
    assert red > 200 and green < 60
    drag(panel.goal_control, SE3.from_xyz_rpy((1.5, 0.0, 0.4), DOWN))
    until(lambda: "out of reach" in panel.label.text and " mm" in panel.plan.goal.content)
    until(lambda: panel.goal_ghost._parts["panda_hand"][0].color == tuple(round(255 * c) for c in GREY[:3]))


@pytest.mark.slow
def test_plan_preview_execute(panel):
    assert panel.plan.execute.disabled and panel.plan.preview.disabled and panel.plan.stop.disabled
    panel.states.named.value = "extended"
    click(panel.plan.plan)
    until(lambda: "SUCCESS" in panel.plan.result.content and not panel.plan.execute.disabled)
    for word in ("duration", "length", "clearance", "planned by"):
        assert word in panel.plan.result.content
    duration = panel.session.result.trajectory.duration
    assert duration <= panel.plan.time.max < duration + 0.011
    panel.plan.time.value = round(duration / 2, 2)
    there = panel.session.positions_at(panel.plan.time.value)
    hand = kinematic_tree(panel.session.scene.model).link_pose(there, "panda_hand")
    until(lambda: pose(panel.preview_ghost._frames["panda_hand"]).isclose(hand, 1e-5, 1e-5))
    click(panel.plan.preview)
    until(lambda: panel._player.playing)
    until(lambda: not panel._player.playing and not panel.preview_ghost.root.visible)
    click(panel.plan.execute)
    until(lambda: panel.session.outcome is not None and not panel.session.busy)
    assert panel.session.outcome.ok
    until(lambda: panel.plan.execute.disabled)
    end = kinematic_tree(panel.session.scene.model).link_pose(panel.session.scene.positions, "panda_hand")
    until(lambda: pose(panel.viewer.link_frames["panda_hand"]).isclose(end, 1e-5, 1e-5))


@pytest.mark.slow
def test_a_failure_is_explained_and_a_button_mends_it(panel):
    drag(panel.goal_control, SE3.from_xyz_rpy((0.55, 0.06, 0.2), DOWN))
    until(lambda: panel.session.goal.status == "collision")
    click(panel.plan.plan)
    until(lambda: panel.plan.suggestions and panel._why, 90)
    assert "GOAL_IN_COLLISION" in panel.plan.result.content and panel.plan.help.visible
    assert "joint solution" in panel.plan.details.content
    button = next(b for b in panel.plan.suggestions if b.label.startswith("move the goal"))
    click(button)
    until(lambda: "SUCCESS" in panel.plan.result.content, 60)
    until(lambda: not panel._why)
    assert not panel.plan.suggestions and not panel.plan.help.visible
    assert pose(panel.goal_control).isclose(panel.session.goal.T_world_tip, 1e-6, 1e-6)


@pytest.mark.slow
def test_every_planner_is_offered_and_choices_reach_the_session(panel):
    plan, session = panel.plan, panel.session
    for pipeline, planners in pipelines.items():
        plan.pipeline.value = pipeline
        assert plan.planner.options == tuple(planners)
        for planner in planners:
            plan.planner.value = planner
            assert (session.settings.pipeline, session.settings.planner) == (pipeline, planner)
    plan.velocity.value, plan.acceleration.value, plan.attempts.value = 0.5, 0.25, 4
    plan.planning_time.value, plan.motion.value = 2.5, "keep upright"
    s = session.settings
    assert (s.velocity_scaling, s.acceleration_scaling, s.attempts) == (0.5, 0.25, 4)
    assert (s.planning_time, s.motion) == (2.5, "keep upright")
    session.change_settings(pipeline="native", planner="RRTConnect")
    assert (plan.pipeline.value, plan.planner.value) == ("native", "RRTConnect")


@pytest.mark.slow
def test_sliders_are_degrees_and_follow(panel):
    states, session = panel.states, panel.session
    states.sliders["panda_joint1"].value = 30.0
    assert session.goal.positions[0] == pytest.approx(np.pi / 6)
    assert pose(panel.goal_control).isclose(session.goal.T_world_tip, 1e-6, 1e-6)
    states.of.value = "start"
    states.sliders["panda_joint1"].value = -20.0
    assert session.start[0] == pytest.approx(np.deg2rad(-20.0)) and panel.start_ghost.root.visible
    click(states.present)
    assert session.start is None and not panel.start_ghost.root.visible
    states.of.value = "goal"
    assert states.sliders["panda_joint1"].value == pytest.approx(30.0)
    panel.plan.group.value = "hand"
    assert list(states.sliders) == ["panda_finger_joint1"] and not panel.goal_control.visible
    states.sliders["panda_finger_joint1"].value = 10.0  # [mm]
    assert session.goal.positions[7] == pytest.approx(0.01)


@pytest.mark.slow
def test_objects_are_added_dragged_attached_and_removed(panel):
    tab, session = panel.scene, panel.session
    tab.kind.value = "cylinder"
    assert [n.visible for n in tab.sizes] == [True, True, False] and tab.sizes[1].label == "length [m]"
    tab.sizes[0].value, tab.sizes[1].value, tab.at.value = 0.03, 0.2, (0.4, 0.3, 0.9)
    click(tab.add)
    assert session.scene.objects["cylinder_1"].shapes[0][0].length == 0.2
    assert "cylinder_1" in panel.viewer.object_frames and "cylinder_1" in tab.tree.content
    assert panel.object_control.visible
    there = SE3.from_xyz(0.3, 0.2, 0.95)
    drag(panel.object_control, there)
    until(lambda: pose(panel.viewer.object_frames["cylinder_1"]).isclose(there, 1e-6, 1e-6))
    click(tab.attach)
    assert "cylinder_1" in session.scene.attached and tab.attach.label == "Detach"
    click(tab.remove)
    assert "held by the robot" in panel.plan.result.content and "cylinder_1" in session.scene.attached
    click(tab.attach)
    click(tab.remove)
    assert "cylinder_1" not in panel.viewer.object_frames and tab.chosen.value == "-"


@pytest.mark.slow
def test_boxes_say_what_may_touch(panel):
    tab, session = panel.scene, panel.session
    tab.body.value = "panda_hand"
    assert {"wall", "panda_link7"} <= set(tab.pairs)
    assert tab.pairs["panda_link7"].value and not tab.pairs["wall"].value
    tab.pairs["wall"].value = True
    assert session.scene.is_allowed("panda_hand", "wall")
    session.change_scene(lambda now: now.with_allowed("panda_hand", "wall", False))
    assert not tab.pairs["wall"].value


@pytest.mark.slow
def test_files(panel, tmp_path):
    tab = panel.scene
    tab.file.value = "mine.scene"
    click(tab.save)
    assert (tmp_path / "mine.scene").exists() and "5 objects written" in panel.plan.result.content
    tab.chosen.value = "post"
    click(tab.remove)
    click(tab.load)
    assert "post" in panel.session.scene.objects
    tab.file.value = "../elsewhere.yaml"
    click(tab.save)
    assert "not a plain file name" in panel.plan.result.content


@pytest.mark.slow
def test_what_is_shown_is_text_not_markup(panel):
    panel.session.say("<script>alert(1)</script>")
    assert "<script>" not in panel.plan.result.content and "&lt;script&gt;" in panel.plan.result.content


@pytest.mark.slow
def test_closing_leaves_no_thread(cell, tmp_path):
    before = set(threading.enumerate())
    session = PlanningSession(cell.scene())
    panel = PlanningPanel(session, port=0, folder=tmp_path)
    session.set_random()
    session.plan()
    panel.close()
    until(lambda: set(threading.enumerate()) <= before)
