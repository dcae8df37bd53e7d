"""A Panda and a UR10e, each with its vendor's emulated controller, in one physics world, without network."""

from __future__ import annotations

import selectors
import threading

import numpy as np
import pytest
from tests.drivers.franka.emulated import free_host
from tests.drivers.ur.emulated import free_hosts

from armcell.cell import load, with_values
from armcell.core import SE3, UnknownNameError
from armcell.drivers.real import RealSettings, real_settings
from armcell.emulators import cell_rack, emulated_kinds
from armcell.emulators.franka import FrankaController
from armcell.emulators.rack import Rack
from armcell.emulators.ur import PhysicsPlant, UrController

CELL = "panda_ur10e_handover"


@pytest.fixture
def rack():
    hosts = {"real.arms.franka_arm.host": free_host(), "real.arms.ur_arm.host": free_hosts(1)[0]}
    cell = with_values(load(CELL), hosts)
    settings = real_settings(cell.spec.real, cell.model)
    made = cell_rack(settings, cell.scene(0), cell.physics, lambda text: None)
    yield made
    made.close()


def test_the_controller_with_the_shortest_period_drives_the_time(rack):
    franka, ur = rack.controllers
    assert isinstance(franka, FrankaController) and isinstance(ur, UrController)
    world = franka.plant.world
    assert isinstance(ur.robot.plant, PhysicsPlant) and ur.robot.plant.world is world
    begun, ur_begun = world.time, ur.robot.time
    for _ in range(50):
        ur.step()
        franka.step()
        franka.step()
    assert world.time - begun == pytest.approx(0.1) and ur.robot.time - ur_begun == pytest.approx(0.1)


@pytest.mark.slow
def test_each_controller_moves_its_own_arm(rack):
    franka, ur = rack.controllers
    q_franka, q_ur = franka.robot.q.copy(), ur.robot.plant.read()[0].copy()
    wanted = q_ur + 0.02
    for k in range(500):
        ur.robot.plant.command(q_ur + 0.02 * min(k / 250, 1.0), np.zeros(6), ur.period)
        ur.robot.plant.step(ur.period)
        franka.step()
        franka.step()
    np.testing.assert_allclose(ur.robot.plant.read()[0], wanted, atol=2e-3)
    np.testing.assert_allclose(franka.robot.q, q_franka, atol=1e-3)
    assert franka.plant.world.monitor.unwanted == ()


def test_a_reset_at_one_controller_resets_the_whole_world(rack):
    franka, ur = rack.controllers
    world = franka.plant.world
    q_franka, q_ur, bar = franka.robot.q.copy(), ur.robot.plant.read()[0].copy(), world.object_pose("bar")
    for reset in (ur.reset, franka.reset):
        world.set_object_pose("bar", SE3.from_xyz(0.1, 0.1, 0.1) @ bar)
        franka.robot.displace(q_franka + 0.1)
        ur.robot.displace(q_ur + 0.1)
        for _ in range(5):
            franka.step()
            ur.step()
        reset()
        for _ in range(20):
            franka.step()
            ur.step()
        np.testing.assert_allclose(franka.robot.q, q_franka, atol=2e-3)
        np.testing.assert_allclose(franka.robot.reference.q, q_franka, atol=2e-3)
        np.testing.assert_allclose(ur.robot.setpoint.q, q_ur, atol=2e-3)
        assert world.object_pose("bar").distance_to(bar)[0] < 2e-3


class Ticking:
    """A controller that counts its steps; one of its steps may take long."""

    answer_time, in_use = 0.0, False

    def __init__(self, period: float, network):
        self.period, self.network, self.steps = period, network, 0

    def step(self) -> None:
        self.steps += 1

    def reset(self) -> None: ...

    def trace(self) -> bytes:
        return b""

    def close(self) -> None: ...


def test_a_rack_runs_each_controller_at_its_own_period(rack):
    network = rack.controllers[0].network
    fast, slow = Ticking(0.002, network), Ticking(0.008, network)
    both = Rack([fast, slow], selectors.SelectSelector())
    both._opened = True
    thread = threading.Thread(target=both.run)
    thread.start()
    thread.join(0.4)
    both.stop()
    thread.join()
    assert fast.steps == pytest.approx(4 * slow.steps, abs=5) and slow.steps > 10


def test_each_installed_robot_kind_has_an_emulator():
    assert {"ur", "franka"} <= set(emulated_kinds)
    with pytest.raises(UnknownNameError, match="emulated kind of robot 'toy'"):
        emulated_kinds["toy"]
    assert RealSettings.model_fields["kind"].default in emulated_kinds
