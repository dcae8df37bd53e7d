"""The contract of a driver whose robot another program serves on the bus."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from tests.drivers.test_drivers import (
    close,
    test_a_wrong_command_is_refused_and_changes_nothing,  # noqa: F401  (collected here, with this driver)
    test_an_unknown_gripper_is_refused_and_changes_nothing,  # noqa: F401
    test_gripper_closes_on_what_is_between_and_lets_go,  # noqa: F401
    test_joint_state_is_all_actuated_joints_in_the_model_s_order,  # noqa: F401
    test_nothing_to_report_when_nothing_happened,  # noqa: F401
    test_object_poses_are_those_of_the_movable_objects,  # noqa: F401
    test_without_a_command_it_stays,  # noqa: F401
)
from tests.execution.helpers import ARM, GRIPPER, alone, make, motion, scene, swing
from tests.execution.ungated import execute

from armcell.cell import LiveCell
from armcell.collision.motion_proof import ActiveMotion, first_conflict
from armcell.core import ErrorCode, InputError
from armcell.drivers import Capability
from armcell.ros import Bus
from armcell.ros.nodes import CellNode, RemoteDriver
from armcell.tasks import TaskSettings

SCALE = 4.0  # cell time per wall time


@pytest.fixture(scope="module", autouse=True)
def loaded():
    """The first proof loads compiled code, which stops every thread of this process for seconds."""
    for world in (alone(), scene().with_attached("cube", GRIPPER.tcp_link, GRIPPER.hand_links)):
        first_conflict(world, ActiveMotion(swing(0.1, 1.0)))


@contextmanager
def remote(mode: str, world) -> Iterator[RemoteDriver]:
    """A served cell, and the driver at the other end of its bus."""
    bus, robot = Bus(), make(mode, world, time_scale=SCALE)
    node = CellNode(LiveCell("served", world, robot, TaskSettings(), (), 0), bus)
    thread = node.start()
    try:
        assert node.ready.wait(120)
        with RemoteDriver(bus, world) as driver:
            driver.wait_for_state()
            yield driver
    finally:
        node.close()
        thread.join(10)


@pytest.fixture
def driver():
    with remote("fake", scene()) as connected:
        yield connected


@pytest.fixture(params=["fake", "sim"])
def free(request):
    """A robot in an empty world."""
    with remote(request.param, alone()) as connected:
        yield connected


def at(driver):
    return driver.joint_state().reindexed(ARM).positions


def test_it_is_a_paced_robot_that_plays_trajectories(driver):
    assert driver.name == "remote" and driver.is_paced and not driver.is_simulated
    assert driver.capabilities == {Capability.PLAY_TRAJECTORY}
    assert driver.now == 0.0 and driver.fault() is None
    driver.advance(10 * driver.period)
    assert driver.now >= 10 * driver.period - 1e-9
    driver.resume()
    with pytest.raises(InputError, match="whole trajectory"):
        driver.command(ARM, at(driver), np.zeros(len(ARM)))


def test_connecting_again_starts_again():
    with remote("fake", alone()) as driver:
        driver.advance(0.1)
    with driver:
        assert driver.now == 0.0


def test_a_trajectory_arrives(free):
    wanted = swing(0.3, 1.0)
    result = execute(free, wanted)
    assert result.ok, result.message
    np.testing.assert_allclose(at(free), wanted.positions[-1], atol=5e-3)


def test_the_robots_refusal_is_the_result(free):
    """The served cell starts no motion beyond a joint limit, and says so."""
    handle = free.follow(swing(9.0, 1.0))
    free.advance(0.5)
    outcome = handle.state()
    assert outcome.code is ErrorCode.CONTROL_FAILED and "outside its limits" in outcome.message


@pytest.mark.slow
@pytest.mark.cases("sim-hold", "fake-cancel", "sim-stop")
@pytest.mark.parametrize("how", ["cancel", "stop", "hold"])
def test_a_stop_holds_the_arm_on_its_path(free, how):
    wanted = swing(0.5, 4.0)
    handle = free.follow(wanted)
    free.advance(0.5)
    assert handle.state() == "running"
    {"cancel": handle.cancel, "stop": free.stop, "hold": lambda: free.hold(ARM)}[how]()
    free.advance(0.5)
    assert handle.state().code is ErrorCode.PREEMPTED
    rest = at(free)
    assert 0.01 < rest[0] - wanted.positions[0, 0] < 0.49
    free.advance(0.3)
    np.testing.assert_allclose(at(free), rest, atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["fake", "sim"])
def test_a_held_object_comes_along(mode):
    with remote(mode, scene()) as driver:
        close(driver)
        assert driver.gripper(GRIPPER.name).held == "cube"

        def T_tcp_cube():
            now = scene().with_positions(driver.joint_state().positions)
            return now.frame_pose(GRIPPER.tcp_link).inverse() @ driver.object_poses()["cube"]

        before, goal = T_tcp_cube(), driver.joint_state().reindexed(ARM).as_dict()
        goal[ARM[1]] -= 0.1
        result = execute(driver, motion(goal, 1.5, driver.joint_state()))
        assert result.ok, result.message
        driver.advance(0.2)
        moved = driver.object_poses()["cube"].distance_to(scene().object("cube").T_world_object)[0]
        assert moved > 0.03
        meters, radians = before.distance_to(T_tcp_cube())
        assert meters < 1e-3 and radians < 0.02
        assert driver.gripper(GRIPPER.name).held == "cube"


def test_the_constructor_does_nothing_yet():
    bus = Bus()
    RemoteDriver(bus, scene())
    assert not bus.topics()
