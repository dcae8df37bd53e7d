"""The contract of every driver. A new driver is tested by being registered."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest
from tests.execution.helpers import ARM, CUBE, GRIPPER, ROBOT, make, scene

from armcell.core import InputError, UnknownNameError
from armcell.drivers import DriverOptions, drivers

FORCE = 30.0  # [N]


@pytest.fixture(params=[n for n in drivers if n != "real"])  # real arms: tests/drivers/ur
def name(request):
    return request.param


@pytest.fixture
def driver(name):
    with make(name) as connected:
        yield connected


def home():
    return scene().state.reindexed(ARM).positions


def close(driver, force=FORCE):
    driver.command_gripper(GRIPPER.name, 0.0, force)
    driver.advance(1.0)


def test_both_modes_of_a_cell_are_registered():
    assert {"sim", "fake"} <= set(drivers)


def test_unknown_mode_names_the_known():
    with pytest.raises(UnknownNameError, match="fake, real, sim"):
        drivers["simm"]


def test_with_connects_and_gives_the_driver_itself(name):
    driver = make(name)
    with driver as connected:
        assert connected is driver
        assert driver.name == name
        assert driver.period > 0
        assert driver.is_simulated


def test_it_says_whether_it_keeps_to_the_walls_clock_and_resumes_where_nothing_stopped_it(name):
    with make(name) as driver:
        assert driver.is_paced is False
        driver.command(ARM, home() + 0.05, np.zeros(len(ARM)))
        driver.advance(0.1)
        targets, now = driver.targets(), driver.now
        driver.resume()
        driver.resume()
        assert driver.now == now and np.array_equal(driver.targets().positions, targets.positions)


def test_an_error_inside_with_comes_out(name):
    with pytest.raises(ZeroDivisionError), make(name):
        raise ZeroDivisionError


def test_connecting_again_starts_again(name):
    driver = make(name)
    for _ in range(2):
        with driver:
            assert driver.now == 0.0
            np.testing.assert_allclose(driver.joint_state().positions, scene().positions, atol=1e-9)
            driver.command(ARM, home() + 0.1, np.zeros(len(ARM)))
            driver.advance(0.3)


def test_only_advance_lets_time_pass(driver):
    driver.command(ARM, home(), np.zeros(len(ARM)))
    driver.command_gripper(GRIPPER.name, 0.03, FORCE)
    driver.joint_state(), driver.gripper(GRIPPER.name), driver.object_poses()
    driver.expect_contact("cube", GRIPPER.finger_links)
    driver.watch_object("cube", ["stand"])
    driver.unwatch_object("cube")
    driver.unwanted_contacts(), driver.welds(), driver.stop()
    assert driver.now == 0.0
    for k in range(1, 4):
        driver.advance(10 * driver.period)
        assert driver.now == pytest.approx(10 * k * driver.period, abs=1e-9)


def test_joint_state_is_all_actuated_joints_in_the_model_s_order(driver):
    state = driver.joint_state()
    assert state.joint_names == ROBOT.joint_names
    assert state.time == driver.now
    assert state.velocities is not None
    state.positions[:] = 9.0  # a value handed out is not the driver's memory
    np.testing.assert_allclose(driver.joint_state().positions, scene().positions, atol=1e-9)


def test_command_returns_what_was_sent_and_the_arm_goes_there(driver):
    names = (ARM[3], ARM[0])  # fewer joints, another order
    target = scene().state.reindexed(names).positions + np.array([0.05, -0.05])
    sent = driver.command(names, target, np.zeros(2))
    assert sent.joint_names == names
    np.testing.assert_allclose(sent.positions, target)
    driver.advance(1.0)
    np.testing.assert_allclose(driver.joint_state().reindexed(names).positions, target, atol=2e-3)
    rest = [n for n in ARM if n not in names]
    np.testing.assert_allclose(
        driver.joint_state().reindexed(rest).positions, scene().state.reindexed(rest).positions, atol=2e-3
    )


def test_without_a_command_it_stays(driver):
    driver.advance(1.0)
    np.testing.assert_allclose(driver.joint_state().reindexed(ARM).positions, home(), atol=2e-3)


@pytest.mark.parametrize(
    ("names", "value", "error"), [(ARM[:1], np.nan, InputError), (("elbow",), 0.0, UnknownNameError)]
)
def test_a_wrong_command_is_refused_and_changes_nothing(driver, names, value, error):
    with pytest.raises(error):
        driver.command(names, [value], [0.0])
    driver.advance(driver.period)
    np.testing.assert_allclose(driver.joint_state().positions, scene().positions, atol=1e-3)


def test_an_unknown_gripper_is_refused_and_changes_nothing(driver):
    with pytest.raises(UnknownNameError, match=GRIPPER.name):
        driver.gripper("claw")
    with pytest.raises(UnknownNameError, match=GRIPPER.name):
        driver.command_gripper("claw", 0.0, FORCE)
    driver.advance(driver.period)


def test_object_poses_are_those_of_the_movable_objects(driver):
    poses = driver.object_poses()
    assert set(poses) == {"cube"}
    assert poses["cube"].isclose(scene().object("cube").T_world_object, 1e-9, 1e-9)


def test_gripper_closes_on_what_is_between_and_lets_go(driver):
    before = driver.gripper(GRIPPER.name)
    assert before.held is None and before.width == pytest.approx(GRIPPER.max_width, abs=1e-3)
    close(driver)
    holding = driver.gripper(GRIPPER.name)
    assert holding.held == "cube"
    assert holding.width == pytest.approx(CUBE, abs=1e-3)
    assert holding.force_per_finger == pytest.approx(FORCE, rel=0.05)
    driver.command_gripper(GRIPPER.name, 0.07, FORCE)
    driver.advance(1.0)
    after = driver.gripper(GRIPPER.name)
    assert after.held is None and after.force_per_finger == 0.0
    assert after.width == pytest.approx(0.07, abs=1e-3)


def test_gripper_holds_an_object_between_the_ends_of_its_pads(name):
    """The tcp is above the object, as above a low object on a table."""
    lower = -CUBE / 2 - GRIPPER.pad_depth / 2
    world = scene()
    for item in ("stand", "cube"):
        world = world.with_object_pose(item, world.object(item).T_world_object.shifted(z=lower))
    with make(name, world) as driver:
        close(driver)
        holding = driver.gripper(GRIPPER.name)
        assert holding.held == "cube" and holding.width == pytest.approx(CUBE, abs=1e-3)


def test_a_held_object_comes_along(driver):
    close(driver)

    def T_tcp_cube():
        now = scene().with_positions(driver.joint_state().positions)
        return now.frame_pose(GRIPPER.tcp_link).inverse() @ driver.object_poses()["cube"]

    before, start = T_tcp_cube(), home()
    for k in range(1, 101):  # up, then to the side
        target = start.copy()
        target[1] -= 0.1 * min(k, 50) / 50
        target[0] += 0.3 * max(k - 50, 0) / 50
        driver.command(ARM, target, np.zeros(len(ARM)))
        driver.advance(0.02)
    driver.advance(0.3)
    moved = driver.object_poses()["cube"].distance_to(scene().object("cube").T_world_object)[0]
    assert moved > 0.05
    meters, radians = before.distance_to(T_tcp_cube())
    assert meters < 1e-3 and radians < 0.02


def test_stop_holds_the_measured_position(driver):
    q = home()
    for _ in range(50):  # at 1 rad/s
        q[0] += 1.0 * driver.period
        driver.command(ARM, q, np.eye(len(ARM))[0])
        driver.advance(driver.period)
    stopped_at = driver.joint_state().reindexed(ARM).positions
    driver.stop()
    driver.advance(1.0)
    resting = driver.joint_state().reindexed(ARM)
    assert np.abs(resting.positions - stopped_at).max() < 0.05
    assert np.abs(resting.velocities).max() < 1e-3
    driver.advance(0.5)
    still = driver.joint_state().reindexed(ARM).positions
    np.testing.assert_allclose(still, resting.positions, atol=1e-3)


def test_nothing_to_report_when_nothing_happened(driver):
    driver.advance(0.2)
    assert driver.unwanted_contacts() == []
    assert driver.welds() == []


def test_time_scale_paces_the_clock_by_the_wall(name):
    with make(name, time_scale=2.0) as driver:
        driver.advance(driver.period)
        begin, then = time.monotonic(), driver.now
        for _ in range(round(0.4 / driver.period)):
            driver.advance(driver.period)
        passed = driver.now - then
        assert time.monotonic() - begin > 0.9 * passed / 2.0


def test_same_commands_same_states(name):
    def run():
        with make(name, seed=3) as driver:
            driver.command(ARM, home() + 0.05, np.zeros(len(ARM)))
            close(driver)
            return driver.joint_state().positions, driver.object_poses()["cube"].matrix

    for a, b in zip(run(), run()):
        assert np.array_equal(a, b)


def test_the_constructor_does_nothing_yet(name, monkeypatch):
    """No I/O, no physics: a cell can be described without being connected."""
    cell, threads = scene(), threading.active_count()
    monkeypatch.delattr("mujoco.MjModel")
    monkeypatch.delattr("socket.socket")
    drivers[name](cell, DriverOptions())
    assert threading.active_count() <= threads
