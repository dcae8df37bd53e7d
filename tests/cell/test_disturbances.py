"""What a cell says is wrong with its robot really acts in physics: against pinocchio, Newton and delays."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from tests.cli.helpers import cell_file
from tests.model.helpers import PinRobot, pin_library

from armcell.cell import load, parse_value, run_task, with_values
from armcell.core import InputError, UnknownNameError
from armcell.kinematics import kinematic_tree

CELL = """robot: panda
start: {arm: home}
physics: {gravity: [0, 0, 0], full_gain_effort: 1.0}
objects:
  block: {box: [0.1, 0.1, 0.1], pose: [0.9, 0.9, 1.5], movable: true, mass: 0.5}
task: [{move: extended}]
"""
HAND = "panda_hand"
IN_THE_WAY = {"disturbances.moved.wall.by.y": -0.12, "disturbances.moved.wall.at": 4.0}


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    return load(cell_file(tmp_path_factory.mktemp("cell"), CELL))


@pytest.fixture(scope="module")
def reference(cell):
    return PinRobot(pin_library("panda"), cell.model)


def hand(reference, model, q):
    """Pinocchio's T_world_hand."""
    reference.place(kinematic_tree(model).full_positions(q))
    return reference.pose(HAND)


def test_a_joint_offset_shifts_the_tip_as_forward_kinematics_says(cell, reference):
    off = with_values(cell, {"disturbances.joint_offset_deg.panda_joint2": 2.0})
    column = cell.model.columns(["panda_joint2"])[0]
    for varied, offset in ((cell, 0.0), (off, np.deg2rad(2.0))):
        with varied.connect("sim", 0) as live:
            for target in (None, "extended"):
                if target:
                    assert live.arm.move_to(target)
                told = live.driver.joint_state().positions  # what the encoders say
                true = told.copy()
                true[column] += offset
                want = hand(reference, cell.model, true)
                got = live.driver.world.link_pose(HAND).matrix
                np.testing.assert_allclose(got, want, atol=1e-6)
                shift = np.linalg.norm(want[:3, 3] - hand(reference, cell.model, told)[:3, 3])
                assert (shift > 0.01) == bool(offset)
            goal = cell.model.named_state("arm", "extended")
            np.testing.assert_allclose(  # the task went where its encoders say that it is
                live.driver.joint_state().reindexed(goal.joint_names).positions, goal.positions, atol=0.005
            )


def ramp(cell, steps=60):
    """True positions of the arm at each period of a ramp of joint 4."""
    with cell.connect("sim", 0) as live:
        driver, rows = live.driver, []
        q = driver.joint_state()
        for k in range(steps):
            positions = q.positions.copy()
            positions[3] += 0.002 * k
            driver.command(q.joint_names[:7], positions[:7], np.zeros(7))
            driver.advance(driver.period)
            rows.append(driver.world.joint_state().positions)
        return np.array(rows), driver.period


def test_latency_delays_the_same_motion(cell):
    now, period = ramp(cell)
    later, _ = ramp(with_values(cell, {"disturbances.latency": 10 * period}))
    np.testing.assert_allclose(later[10:, 3], now[:-10, 3], atol=1e-6)
    assert np.abs(later[:, 3] - now[:, 3]).max() > 0.01


def test_noise_has_its_deviation_and_does_not_move_the_arm(cell):
    noisy = with_values(cell, {"disturbances.joint_noise_deg": 0.1})
    with noisy.connect("sim", 3) as live:
        rows, true = [], []
        for _ in range(300):
            live.driver.advance(live.driver.period)
            rows.append(live.driver.joint_state().positions[:7])
            true.append(live.driver.world.joint_state().positions[:7])
            np.testing.assert_array_equal(rows[-1], live.driver.joint_state().positions[:7])
    error = np.array(rows) - np.array(true)
    assert np.ptp(np.array(true), axis=0).max() < 1e-4
    assert np.std(error) == pytest.approx(np.deg2rad(0.1), rel=0.05)  # 2100 draws: 1.5 % is one deviation
    assert np.abs(np.corrcoef(error.T) - np.eye(7)).max() < 0.25


def test_a_push_changes_momentum_as_newton_says(cell):
    pushed = with_values(
        cell,
        {"disturbances.pushes.bump": {"on": "block", "at": 0.101, "duration": 0.05, "force": [0, 4, -2]}},
    )
    with pushed.connect("sim", 0) as live:
        for until, share in ((0.1, 0.0), (0.126, 0.5), (0.2, 1.0), (0.4, 1.0)):
            live.driver.advance(until - live.driver.now)
            velocity = live.driver.world.object_twist("block")[:3]
            want = share * np.array([0.0, 4.0, -2.0]) * 0.05 / 0.5
            np.testing.assert_allclose(velocity, want, atol=0.02 if share == 0.5 else 1e-3)


def test_a_pushed_arm_gives_way_by_its_gains(cell, reference):
    """At rest under a force the servo's torque is J^T F, so with the gain kp a joint is J^T F / kp away."""
    force = np.array([0.0, 20.0, 10.0])
    push = {"on": HAND, "at": 0.0, "duration": 10.0, "force": force.tolist()}
    for kp in (5000.0, 2500.0):
        pushed = with_values(cell, {"disturbances.pushes.lean": push, "physics.arm_kp": kp})
        with pushed.connect("sim", 0) as live:
            start = live.driver.joint_state().positions[:7]
            live.driver.advance(3.0)
            moved = live.driver.joint_state().positions
            world = live.driver.world
        reference.place(kinematic_tree(cell.model).full_positions(moved))
        J = reference.jacobian(HAND)[:, :7]
        arm = world.mj_data.xipos[world.built.body[HAND]] - reference.pose(HAND)[:3, 3]
        torque = J[:3].T @ force + J[3:].T @ np.cross(arm, force)  # the force acts at the center of mass
        np.testing.assert_allclose(moved[:7] - start, torque / kp, atol=3e-5)


@pytest.mark.slow
@pytest.mark.parametrize(
    "values", [{"disturbances.latency": 0.05}, {"disturbances.joint_offset_deg.panda_joint2": 2.0}]
)
def test_a_motion_that_nobody_watches_is_disturbed_as_one_that_is(cell, values):
    """Nobody watches the trials of a campaign, whose motions may be played at once."""

    class Watcher:
        def on_state(self, *news):
            pass

        on_event = on_trajectory = on_state

    found = []
    for observers in ((), (Watcher(),)):
        with with_values(cell, values).connect("sim", 0, observers) as live:
            assert live.arm.move_to("extended")
            found.append((live.driver.now, live.driver.world.joint_state().positions))
    assert found[0][0] == found[1][0]
    np.testing.assert_array_equal(found[0][1], found[1][1])


def yawed(angle, T):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ T.rotation.matrix


@pytest.mark.long
def test_what_is_moved_stands_elsewhere_in_physics_only():
    cell = load("panda_pick")
    moved = with_values(
        cell,
        {
            "disturbances.moved.wall.by.x": 0.03,
            "disturbances.moved.wall.turn_deg": 20.0,
            "disturbances.moved.post.at": 0.1,
            "disturbances.moved.post.by": [0.0, 0.0, 0.2],
            "disturbances.moved.cube": {"by": [0.0, 0.1, 0.0], "at": 0.05},
        },
    )
    told = moved.scene(3).objects
    with moved.connect("sim", 3) as live:
        world = live.driver.world
        pictures = []
        for time in (0.0, 0.06, 0.12):
            if time:
                live.driver.advance(time - live.driver.now)
            pictures.append(live.camera("overview").image(rgb=False).depth)
            wall, post, cube = (world.object_pose(name) for name in ("wall", "post", "cube"))
            nominal = told["wall"].T_world_object
            np.testing.assert_allclose(wall.translation - nominal.translation, [0.03, 0, 0], atol=1e-12)
            np.testing.assert_allclose(wall.rotation.matrix, yawed(np.deg2rad(20.0), nominal), atol=1e-12)
            up = post.translation[2] - told["post"].T_world_object.translation[2]
            assert up == pytest.approx(0.2 if time > 0.1 else 0.0, abs=1e-12)
            aside = cube.translation[1] - told["cube"].T_world_object.translation[1]
            assert aside == pytest.approx(0.1 if time > 0.05 else 0.0, abs=1e-4)
            for name in ("wall", "post", "cube"):  # what is planned with does not know
                assert live.scene().objects[name].T_world_object.isclose(told[name].T_world_object)
        assert world.scene().objects["wall"].T_world_object.isclose(wall)  # this is the truth
        world.reset()
        assert world.object_pose("wall").isclose(nominal)
    with cell.connect("sim", 3) as live:
        pictures.insert(0, live.camera("overview").image(rgb=False).depth)
    for one, next_one in pairwise(pictures):  # cameras see the wall where it is, then the cube, then the post
        assert (np.abs(one - next_one) > 0.005).sum() > 20


@pytest.mark.slow
def test_a_wall_moved_into_the_way_is_touched():
    def run(values):
        cell = with_values(load("panda_pick"), values)
        with cell.connect("sim", 5) as live:
            return run_task(cell, live, 5, "sim")

    plain = run({})
    assert plain["success"] and not plain["unwanted_contacts"]
    touched = {c[k] for c in run(IN_THE_WAY)["unwanted_contacts"] for k in ("body_a", "body_b")}
    assert "wall" in touched
    again = run({})  # what was moved is not there any more in the next world
    for result in (plain, again):
        for report in result["stages"]:
            report.pop("planning_time_s")
        for key in ("wall_time_s", "total_planning_time_s"):
            result.pop(key)
    assert again == plain


@pytest.mark.slow
@pytest.mark.parametrize(("by", "works"), [(0.004, True), (0.12, False)])
def test_a_cube_that_is_not_where_it_is_believed(by, works):
    """A little aside, it is grasped; far away, the hand closes around nothing."""
    cell = with_values(load("panda_pick"), {"disturbances.moved.cube.by.x": by, "settings.attempts": 1})
    with cell.connect("sim", 5) as live:
        picked = live.arm.pick("cube")
        assert bool(picked) == works, picked.message
        lifted = live.driver.world.object_pose("cube").translation[2] > 0.1
        assert lifted == works


@pytest.mark.slow
def test_where_a_moved_cube_is_put_is_judged_by_physics():
    """The hand takes it where it is and lays it down as if it were where it is believed."""
    cell = with_values(load("panda_pick"), {"disturbances.moved.cube.by.y": 0.006})
    with cell.connect("sim", 5) as live:
        result = run_task(cell, live, 5, "sim")
        believed, is_at = live.driver.object_poses()["cube"], live.driver.world.object_pose("cube")
        off = np.linalg.norm((is_at.translation - believed.translation)[:2])
        assert off == pytest.approx(0.006, abs=1e-3)
        assert result["placement_error_m"] == pytest.approx(off, abs=1e-3)
        assert not result["success"] and "mm from its target pose" in result["message"]


@pytest.mark.slow
def test_others_than_the_moved_one_are_known_in_the_hand():
    aside = {"box": [0.04, 0.04, 0.04], "pose": [0.3, -0.5, 0.019], "movable": True, "mass": 0.1}
    cell = with_values(load("panda_pick"), {"objects.other": aside, "disturbances.moved.other.by.x": 0.02})
    with cell.connect("sim", 5) as live:
        assert live.arm.pick("cube")
        assert live.driver.gripper("hand").held == "cube"
        told, there = live.driver.object_poses(), live.driver.world.object_pose
        assert told["cube"].isclose(there("cube"))
        assert there("other").translation[0] - told["other"].translation[0] == pytest.approx(0.02, abs=1e-3)


@pytest.mark.slow
def test_what_is_moved_is_looked_for_and_found():
    """Beside a camera's objects nothing changes: the cube is picked where it was seen, not where it was."""
    cell = with_values(load("six_axis_camera"), {"disturbances.moved.cube.by.y": 0.05})
    with cell.connect("sim", 1) as live:
        assert live.look("above")
        seen = live.scene().objects["cube"].T_world_object.translation
        there = live.driver.world.object_pose("cube").translation
        nominal = cell.scene(1).objects["cube"].T_world_object.translation
        np.testing.assert_allclose(seen, there, atol=0.01)
        assert there[1] - nominal[1] == pytest.approx(0.05, abs=1e-3)


def test_what_is_wrong_is_named(cell):
    far = {"at": 0, "duration": 1, "force": [0, 0, 1]}
    for path, value, told in (
        ("disturbances.joint_offset_deg.panda_join2", 1.0, "did you mean 'panda_joint2'"),
        ("disturbances.joint_offset_deg.panda_finger_joint1", 1.0, "panda_finger_joint1"),
        ("disturbances.latncy", 1.0, "did you mean 'latency'"),
        ("disturbances.latency", -1.0, "latency"),
        ("disturbances.pushes.bump", {"on": "panda_hnd", **far}, "panda_hand"),
        ("disturbances.pushes.bump", {"on": "block", "duraton": 1, **far}, "duration"),
        ("disturbances.pushes.lean.force.x", 1.0, "unknown parameter"),
        ("disturbances.moved.blok.by.x", 0.1, "did you mean 'block'"),
        ("disturbances.moved.block.buy.x", 0.1, "unknown"),
        ("disturbances.moved.block.turn", 0.1, "did you mean 'turn_deg'"),
        ("disturbances.moved.block.by.x", float("nan"), "nan is not a finite number"),
        ("disturbances.moved.block.turn_deg", float("inf"), "inf is not a finite number"),
        ("disturbances.moved.block.at", -1.0, "greater than or equal to 0"),
        ("disturbance.latency", 1.0, "did you mean 'disturbances.latency'"),
        ("physics.arm_kq", 1.0, "did you mean 'arm_k"),
        ("phisics.arm_kp", 1.0, "did you mean 'physics.arm_kp'"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=told):
            with_values(cell, {path: value})
    path, value = parse_value("disturbances.pushes.bump={on: block, at: 0, duration: 1, force: [0, 0, 1]}")
    assert with_values(cell, {path: value}).disturbances.pushes[0].on == "block"  # `on` is no boolean here
    with pytest.raises(UnknownNameError, match="did you mean 'disturbances.pushes.bump.force'"):
        push = {"on": "block", "at": 0, "duration": 1, "force": [0, 0, 1]}
        once = with_values(cell, {"disturbances.pushes.bump": push})
        assert with_values(once, {"disturbances.pushes.bump.force.y": 3}).disturbances.pushes[0].force[1] == 3
        with_values(once, {"disturbances.pushes.bumb.force.y": 3})
