"""Pick, place, move, hold in both modes: what moved, what the reports say, what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.tasks.helpers import (
    PICK_STAGES,
    PLACE_STAGES,
    AtStage,
    live,
    nominal,
    panda_pick,
    stages,
    with_cube,
)

from armcell.core import SE3, Box, ErrorCode, InputError, JointState, UnknownNameError
from armcell.scene import CollisionObject

MODES = ("sim", "fake")
SETTINGS = panda_pick().settings


@pytest.fixture(scope="module", params=MODES)
def done(request):
    """A cell after pick and place, with what was so in between."""
    with live(request.param) as cell:
        cell.before = cell.driver.object_poses()["cube"]
        cell.picked = cell.arm.pick("cube")
        cell.lifted, cell.scene_lifted = cell.driver.object_poses()["cube"], cell.scene()
        cell.held = cell.driver.gripper("hand").held
        cell.placed = cell.arm.place("cube", on="tray")
        yield cell


def test_pick_lifts_the_object(done):
    assert done.picked.ok, done.picked.message
    rise = done.lifted.translation[2] - done.before.translation[2]
    assert rise == pytest.approx(SETTINGS.lift_distance, abs=0.01)
    assert done.held == "cube"


def test_the_scene_shows_what_the_driver_measures(done):
    """Also while the object is attached: its pose is the world's, not what the plan hoped for."""
    assert set(done.scene_lifted.attached) == {"cube"} and "cube" not in done.scene_lifted.objects
    assert done.scene_lifted.frame_pose("cube").isclose(done.lifted, 1e-6, 1e-6)
    now = done.scene()
    assert not now.attached
    assert now.frame_pose("cube").isclose(done.driver.object_poses()["cube"], 1e-9, 1e-9)
    np.testing.assert_allclose(now.positions, done.driver.joint_state().positions, atol=1e-3)


def test_place_leaves_it_in_the_tray(done):
    assert done.placed.ok, done.placed.message
    target, found = done.placed.evidence["placement"].T_world_object, done.driver.object_poses()["cube"]
    meters, radians = target.distance_to(found)
    assert meters < 0.005 and radians < 0.02
    T_tray_cube = nominal().object("tray").T_world_object.inverse() @ found
    assert np.abs(T_tray_cube.translation[:2]).max() < 0.12 - 0.025
    assert T_tray_cube.translation[2] == pytest.approx(0.01 + 0.025, abs=2e-3)
    assert not done.ctx.holding and done.driver.gripper("hand").held is None


def test_nothing_else_was_touched(done):
    assert done.driver.unwanted_contacts() == []
    assert done.driver.welds() == []


def test_reports_tell_the_stages(done):
    assert stages(done) == PICK_STAGES + PLACE_STAGES
    previous_end = 0.0
    for report in done.ctx.reports:
        assert report.ok and report.error == ""
        assert report.motion_time_s > 0
        assert report.started_s == pytest.approx(previous_end, abs=1e-6)  # no time between stages
        previous_end = report.started_s + report.motion_time_s
        moves = report.name not in ("open", "close")
        assert bool(report.planner) == moves and (report.planning_time_s > 0) == moves
        assert (report.clearance_m is not None) == moves
        carries = report.name in ("lift", "move to pre-place", "lower")
        assert (report.slip_m is not None) == carries
    assert done.driver.now == pytest.approx(previous_end, abs=1e-6)
    assert all(r.clearance_m > 0 for r in done.ctx.reports if r.clearance_m is not None)
    assert all(r.slip_m < 2e-3 for r in done.ctx.reports if r.slip_m is not None)


def test_each_stage_begins_and_ends_for_the_observers(done):
    phases = [(e.text, e.data["phase"]) for e in done.ctx.events if e.kind == "stage"]
    assert phases == [(name, phase) for name in stages(done) for phase in ("begin", "end")]
    times = [e.time for e in done.ctx.events]
    assert times == sorted(times)


def test_a_second_object_after_the_first(done):
    """The cell goes on working: what was placed can be picked again and put elsewhere."""
    assert done.arm.pick("cube").ok
    assert done.arm.place("cube", on="table", at=(-0.1, -0.3)).ok
    T = nominal().object("table").T_world_object.inverse() @ done.driver.object_poses()["cube"]
    np.testing.assert_allclose(T.translation[:2], (-0.1, -0.3), atol=0.03)


# --- refused: misuse, one line, nothing moves ---
@pytest.fixture
def cell():
    with live("fake") as connected:
        yield connected


def unmoved(cell) -> bool:
    return cell.driver.now == 0.0 and not cell.ctx.reports


@pytest.mark.parametrize(
    ("ask", "error", "text"),
    [
        (lambda arm: arm.pick("cub"), UnknownNameError, "'cube'"),
        (lambda arm: arm.pick("table"), InputError, "'table' is fixed"),
        (lambda arm: arm.place("cube", on="tray"), InputError, "does not hold 'cube'"),
        (lambda arm: arm.move_to("hone"), UnknownNameError, "'home'"),
    ],
)
def test_misuse_is_an_error_that_names_it(cell, ask, error, text):
    with pytest.raises(error, match=text) as raised:
        ask(cell.arm)
    assert "\n" not in str(raised.value)
    assert unmoved(cell)


def test_what_a_full_hand_refuses_and_that_it_can_still_place(cell):
    assert cell.arm.pick("cube").ok
    reports = len(cell.ctx.reports)
    with pytest.raises(InputError, match="already holds cube"):
        cell.arm.pick("cube")
    with pytest.raises(UnknownNameError, match="'tray'"):
        cell.arm.place("cube", on="trey")
    with pytest.raises(InputError, match="does not fit on 'wall'"):
        cell.arm.place("cube", on="wall")
    with pytest.raises(InputError):
        cell.arm.place("cube", on="cube")
    assert len(cell.ctx.reports) == reports and set(cell.ctx.holding) == {"cube"}
    assert cell.arm.place("cube", on="tray").ok


@pytest.mark.parametrize("duration", [-1.0, float("nan")])
def test_hold_refuses_what_is_no_duration(cell, duration):
    with pytest.raises(InputError):
        cell.arm.hold(duration)


# --- honest failure: a code, the reasons, counts; nothing moves ---
def walled() -> CollisionObject:
    """A box around the cube, open nowhere."""
    walls = [(Box(0.2, 0.2, 0.01), SE3.from_xyz(0, 0, 0.09))]
    walls += [(Box(0.01, 0.2, 0.19), SE3.from_xyz(s * 0.1, 0, 0)) for s in (-1, 1)]
    walls += [(Box(0.2, 0.01, 0.19), SE3.from_xyz(0, s * 0.1, 0)) for s in (-1, 1)]
    at = nominal().object("cube").T_world_object.translation
    return CollisionObject("cage", tuple(walls), SE3.from_xyz(at[0], at[1], 0.096))


def solid() -> CollisionObject:
    """A block that the cube is inside of."""
    at = nominal().object("cube").T_world_object.translation
    return CollisionObject.single("block", Box(0.15, 0.15, 0.15), SE3.from_xyz(at[0], at[1], 0.076))


GEOMETRY = ("100 mm wide, the gripper opens 80 mm", "the gripper has 70 N")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "reason"),
    [
        (with_cube(size=0.1), "100 mm wide, the gripper opens 80 mm"),
        (with_cube(at=(2.0, 0.0)), "out of reach"),
        (with_cube(mass=40.0), "the gripper has 70 N"),
        (nominal().with_object(walled()), "touches cage"),
        (nominal().with_object(solid()), "block"),
    ],
    ids=["too wide", "too far", "too heavy", "caged", "inside another"],
)
def test_what_cannot_be_picked_says_why(scene, reason):
    with live("fake", scene) as cell:
        outcome = cell.arm.pick("cube")
        assert outcome.code is ErrorCode.PLANNING_FAILED
        assert reason in outcome.message and "\n" not in outcome.message
        details = outcome.evidence["rejections"]
        assert f"{len(details)} rejected (" in outcome.message
        assert ("surface was tried" in outcome.message) == (reason in GEOMETRY)
        assert any(reason in why for _, _, why in details)
        assert unmoved(cell)
        assert any(outcome.message == e.text for e in cell.ctx.events if e.kind == "error")


def pit(half: float) -> CollisionObject:
    """Four walls of 30 mm on the table around (-0.1, -0.3), so far [m] from it."""
    walls = [(Box(0.01, 2 * half + 0.02, 0.03), SE3.from_xyz(s * (half + 0.005), 0, 0)) for s in (-1, 1)]
    walls += [(Box(2 * half, 0.01, 0.03), SE3.from_xyz(0, s * (half + 0.005), 0)) for s in (-1, 1)]
    table = nominal().object("table")
    top = table.bounds()[1][2]
    return CollisionObject("pit", tuple(walls), table.T_world_object @ SE3.from_xyz(-0.1, -0.3, top + 0.0155))


@pytest.mark.slow
@pytest.mark.parametrize(("half", "width"), [(0.07, 0.07), (0.048, 0.06), (0.044, 0.055)])
def test_the_fingers_open_no_wider_than_there_is_room(half, width):
    """By 20 mm, where that would touch by a half or a quarter of it."""
    with live("fake", nominal().with_object(pit(half))) as cell:
        assert cell.arm.pick("cube").ok
        outcome = cell.arm.place("cube", on="table", at=(-0.1, -0.3))
        assert outcome.ok, outcome.message
        assert cell.driver.gripper("hand").width == pytest.approx(width, abs=1e-4)


def ring(inner: float) -> CollisionObject:
    """A square ring in the cube's place, whose sides of 30 mm enclose a square hole."""
    cube, outer = nominal().object("cube"), inner + 0.06
    sides = [(Box(0.03, outer, 0.04), SE3.from_xyz(s * (inner + 0.03) / 2, 0, 0)) for s in (-1, 1)]
    sides += [(Box(inner, 0.03, 0.04), SE3.from_xyz(0, s * (inner + 0.03) / 2, 0)) for s in (-1, 1)]
    at = cube.T_world_object.translation - (0, 0, 0.005)
    return CollisionObject("cube", tuple(sides), SE3.from_xyz(*at), movable=True, mass=0.1)


@pytest.mark.slow
def test_a_finger_in_a_ring_opens_no_further_than_the_ring_lets_it():
    """A hand that pressed against the ring's other side never reached its opening."""
    item = ring(0.034)
    scene = nominal().without_object("cube").without_object("wall").with_object(item)
    with live("sim", scene) as cell:
        assert cell.arm.pick("cube").ok
        outcome = cell.arm.place("cube", on="table", pose=item.T_world_object)
        assert outcome.ok, outcome.message
        moved, turned = item.T_world_object.distance_to(cell.driver.object_poses()["cube"])
        assert moved < 0.003 and turned < 0.05


@pytest.mark.parametrize("mode", MODES)
def test_an_object_returns_to_the_pose_where_it_stood(mode):
    cube = nominal().object("cube")
    turned = cube.at(cube.T_world_object @ SE3.from_xyz_rpy((0.0, 0.0, 0.0), (0.0, 0.0, 0.4)))
    with live(mode, nominal().without_object("cube").with_object(turned)) as cell:
        before = cell.driver.object_poses()["cube"]
        assert cell.arm.pick("cube").ok
        outcome = cell.arm.place("cube", on="table", pose=before)
        assert outcome.ok, outcome.message
        moved, angle = before.distance_to(cell.driver.object_poses()["cube"])
        assert moved < 0.003 and angle < 0.02


def test_a_pose_excludes_a_place(cell):
    assert cell.arm.pick("cube").ok
    with pytest.raises(InputError, match="either a pose"):
        cell.arm.place("cube", on="tray", at=(0.0, 0.0), pose=SE3.identity())


@pytest.mark.slow
def test_a_full_tray_is_said_and_keeps_the_object():
    T = nominal().object("tray").T_world_object
    posts = [SE3.from_xyz(0.06 * i, 0.06 * j, 0.05) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    full = CollisionObject("full", tuple((Box(0.03, 0.03, 0.07), p) for p in posts), T)
    with live("fake", nominal().with_object(full)) as cell:
        assert cell.arm.pick("cube").ok
        outcome = cell.arm.place("cube", on="tray")
        assert outcome.code is ErrorCode.PLANNING_FAILED
        assert "cube touches full" in outcome.message and "rejected (" in outcome.message
        assert set(cell.ctx.holding) == {"cube"} == set(cell.scene().attached)


def test_a_place_out_of_reach_keeps_the_object(cell):
    assert cell.arm.pick("cube").ok
    outcome = cell.arm.place("cube", on="table", at=(0.6, 0.7))
    assert outcome.code is ErrorCode.PLANNING_FAILED and "out of reach" in outcome.message
    assert cell.driver.gripper("hand").held == "cube"


# --- moves ---
@pytest.mark.parametrize("mode", MODES)
def test_move_to_a_name_a_pose_and_joints(mode):
    with live(mode) as cell:
        assert cell.arm.move_to("extended").ok
        named = cell.model.named_state("arm", "extended")
        reached = cell.driver.joint_state().reindexed(named.joint_names)
        np.testing.assert_allclose(reached.positions, named.positions, atol=6e-3)
        pose = SE3.from_xyz_rpy((0.4, -0.3, 0.4), (np.pi, 0, 0))
        assert cell.arm.move_to(pose).ok
        meters, radians = cell.scene().frame_pose("panda_hand_tcp").distance_to(pose)
        assert meters < 5e-3 and radians < 0.02
        assert cell.arm.move_to(JointState(("panda_joint1",), [0.4])).ok
        assert cell.driver.joint_state()["panda_joint1"] == pytest.approx(0.4, abs=6e-3)
        assert stages(cell) == ["move to extended", "move", "move"]


@pytest.mark.parametrize(
    ("goal", "code", "word"),
    [
        (SE3.from_xyz(3.0, 0.0, 0.0), ErrorCode.NO_IK_SOLUTION, "cannot reach"),
        (SE3.from_xyz_rpy((0.5, 0.06, 0.2), (np.pi, 0, 0)), ErrorCode.GOAL_IN_COLLISION, "wall"),
        (JointState(("panda_joint1",), [9.0]), ErrorCode.GOAL_STATE_INVALID, "limits"),
    ],
)
def test_a_move_that_cannot_be_says_why(cell, goal, code, word):
    outcome = cell.arm.move_to(goal)
    assert not outcome.ok and word in outcome.message
    assert unmoved(cell)
    assert outcome.code is code


@pytest.mark.parametrize("mode", MODES)
def test_cancel_stops_and_the_cell_can_go_on(mode):
    with live(mode) as cell:
        cell.ctx.observers.append(AtStage("move to pre-grasp", cell.ctx.cancel.set))
        outcome = cell.arm.pick("cube")
        assert outcome.code is ErrorCode.PREEMPTED
        assert not cell.ctx.reports[-1].ok
        assert cell.arm.move_to("home").code is ErrorCode.PREEMPTED  # until it is taken back
        cell.ctx.cancel.clear()
        assert cell.arm.pick("cube").ok


@pytest.mark.slow
def test_straight_motions_end_where_the_arms_reach_ends():
    """Above the cube, the hand of the Panda can move up by about 0.45 m and keep its orientation."""
    far = replace(
        SETTINGS, approach_distance=1.0, lift_distance=1.0, lower_distance=1.0, retreat_distance=1.0
    )
    bare = nominal().without_object("wall").without_object("post")
    with live(scene=bare, settings=far) as cell:
        before = cell.driver.object_poses()["cube"].translation[2]
        picked = cell.arm.pick("cube")
        assert picked.ok, picked.message
        assert 0.2 < cell.driver.object_poses()["cube"].translation[2] - before < 0.8
        placed = cell.arm.place("cube", on="tray")
        assert placed.ok, placed.message
        assert stages(cell) == PICK_STAGES + PLACE_STAGES
    with live(scene=bare, settings=replace(far, least_approach=0.9, max_candidates=2)) as cell:
        assert "stops at" in cell.arm.pick("cube").message
