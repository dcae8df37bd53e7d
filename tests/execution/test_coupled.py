"""Coupled arms: one clock for all, scaling, watching; admittance against its differential equation."""

from __future__ import annotations

import numpy as np
import pytest
from tests.execution.ungated import execute_coupled

import armcell
from armcell.core import SE3, Box, ErrorCode, InputError, JointTrajectory, Outcome
from armcell.drivers import Capability, DriverOptions
from armcell.drivers.execution_handle import SetpointHistory
from armcell.drivers.sim import SimDriver
from armcell.execution import Admittance, AdmittanceSettings
from armcell.execution.setpoints import SCALING_RATE
from armcell.scene import CollisionObject
from armcell.timing import merge_trajectories, synchronize_trajectories
from armcell.twin import TwinSimulation


@pytest.fixture(scope="module")
def cell():
    return armcell.load("dual_ur10")


def ramp(cell, group, angle=0.4, duration=1.0):
    """A quintic of every joint of an arm, from where it stands."""
    names = cell.model.group(group).joint_names
    q = cell.scene().state.reindexed(names).positions
    x = np.linspace(0, 1, 40)
    s = (x**3 * (10 - 15 * x + 6 * x**2))[:, None] * angle
    v = (30 * x**2 * (1 - x) ** 2)[:, None] * angle / duration
    return JointTrajectory(names, x * duration, q + s, np.tile(v, (1, len(names))))


@pytest.fixture(scope="module")
def motion(cell):
    return merge_trajectories(
        *synchronize_trajectories([ramp(cell, "left_arm", -0.4, 1.0), ramp(cell, "right_arm", -0.3, 0.8)])
    )


def arrivals(cell, pair):
    """In physics: when each arm's motion is over and it rests within the goal tolerance [s]."""
    arrived = {}
    with cell.connect("sim") as live:

        def watch():
            for motion in pair:
                state = live.driver.joint_state().reindexed(motion.joint_names)
                off = np.abs(state.positions - motion.positions[-1]).max()
                if (
                    live.driver.now >= motion.duration - 1e-6
                    and off < 5e-3
                    and np.abs(state.velocities).max() < 0.02
                ):
                    arrived.setdefault(motion.joint_names, live.driver.now)

        assert execute_coupled(live.driver, merge_trajectories(*pair), watch=watch).ok
    return list(arrived.values())


@pytest.mark.slow
def test_both_arrive_within_5_ms(cell):
    apart = [ramp(cell, "left_arm", -0.4, 1.0), ramp(cell, "right_arm", -0.3, 0.8)]
    first, second = arrivals(cell, synchronize_trajectories(apart))
    assert abs(first - second) <= 5e-3
    first, second = arrivals(cell, apart)  # so that the test could fail
    assert abs(first - second) > 0.05


def test_the_slower_arm_slows_both(cell, motion):
    with cell.connect("fake") as live:
        result = execute_coupled(live.driver, motion, scalings=lambda: (1.0, 0.5))
        expected = motion.duration / 0.5 - (0.5 / SCALING_RATE) * 0.5 / 2 / 0.5  # the braking is quicker
        assert result.ok and result.duration == pytest.approx(expected, abs=0.05)


def test_a_pause_holds_both_and_goes_on(cell, motion):
    positions, scale = [], [1.0]
    with cell.connect("fake") as live:

        def watch():
            positions.append(live.driver.joint_state().reindexed(motion.joint_names).positions)
            scale[0] = 0.0 if 0.4 < live.driver.now < 2.0 else 1.0

        result = execute_coupled(live.driver, motion, watch=lambda: watch(), scalings=lambda: (scale[0], 1.0))
    assert result.ok
    moved = np.abs(np.diff(positions, axis=0)).max(axis=1)
    still = np.flatnonzero(moved == 0.0)
    assert len(still) >= 80  # a second of ticks of 10 ms
    assert np.abs(np.diff(moved)).max() < 2e-3  # no jump of the speed, into the pause or out of it
    np.testing.assert_allclose(positions[-1], motion.positions[-1], atol=1e-9)


def test_what_the_watch_says_stops_both(cell, motion):
    with cell.connect("sim") as live:
        trouble = Outcome(ErrorCode.CONTROL_FAILED, "enough")
        result = execute_coupled(
            live.driver, motion, watch=lambda: trouble if live.driver.now > 0.4 else None
        )
        assert result.code is ErrorCode.CONTROL_FAILED and result.message == "enough"
        live.driver.advance(0.5)
        before = live.driver.joint_state().positions
        live.driver.advance(0.5)
        np.testing.assert_allclose(live.driver.joint_state().positions, before, atol=1e-3)


def test_a_start_elsewhere_moves_nothing(cell, motion):
    with cell.connect("fake") as live:
        shifted = JointTrajectory(
            motion.joint_names, motion.times, motion.positions + 0.05, motion.velocities
        )
        result = execute_coupled(live.driver, shifted)
        assert result.code is ErrorCode.CONTROL_FAILED and "plan again" in result.message
        assert live.driver.now == 0.0


class Rehearsed(SimDriver):
    """In physics, yet with a twin, in whose cell something else may stand."""

    capabilities = SimDriver.capabilities | {Capability.DRY_RUN}

    def __init__(self, cell, *things):
        super().__init__(cell.scene(), DriverOptions(physics=cell.physics))
        scene = cell.scene()
        for thing in things:
            scene = scene.with_object(thing)
        self.stage, self.told, self.ended = TwinSimulation(scene, cell.physics), [], []

    def dry_run(self, trajectory):
        outcome = self.stage.play(trajectory, self.joint_state(), {}, {}).outcome
        return None if outcome.ok else outcome

    def monitor_execution(self, trajectory, forced):
        self.forced = forced
        return self

    def record_setpoint(self, clock, off):
        self.told.append((clock, off))

    def check(self):
        pass

    def end(self, how):
        self.ended.append(how)


def test_a_coupled_motion_is_rehearsed_and_told_of_point_by_point(cell, motion):
    def correct(clock, q, v):
        return q + 1e-3, v

    with Rehearsed(cell) as driver:
        assert execute_coupled(driver, motion, correct).ok
        assert driver.forced and driver.ended == ["done"]
        clocks = [clock for clock, _ in driver.told]
        assert clocks[0] > 0.0 and clocks[-1] == motion.duration and (np.diff(clocks) >= 0).all()
        np.testing.assert_allclose([off for _, off in driver.told], 1e-3)
    tip = cell.scene().with_state(motion.end).frame_pose("left_gripper_tcp").translation
    wall = CollisionObject.single("wall", Box(0.1, 0.1, 0.1), SE3.from_xyz(*tip))
    with Rehearsed(cell, wall) as driver:
        before = driver.joint_state().positions
        refused = execute_coupled(driver, motion)
        assert refused.code is ErrorCode.CONTROL_FAILED and "wall touches" in refused.message
        assert driver.told == []  # nothing was commanded
        driver.advance(0.2)
        np.testing.assert_allclose(driver.joint_state().positions, before, atol=1e-3)


def test_where_robots_are_that_get_points_ahead_of_time():
    clock = SetpointHistory()
    assert clock.at(5.0) == (0.0, None)
    for k in range(3):
        clock.record(10.0 + k, 0.5 * k, np.full(2, k))
    assert clock.at(9.0)[0] == 0.0 and clock.at(99.0)[0] == 1.0
    between, off = clock.at(11.5)
    assert between == pytest.approx(0.75) and off is not None and off.tolist() == [2, 2]


# --- admittance ---
def test_a_steady_force_moves_as_the_formula_says():
    s = AdmittanceSettings(damping=1000, dead_band=2.0, max_speed=1.0, max_offset=1.0, filter_time=0.0)
    a = Admittance(s, 3)
    for _ in range(500):
        a.update([12.0, 0.0, 0.0], 0.002)
    np.testing.assert_allclose(a.offset, [10.0 / 1000 * 1.0, 0, 0], rtol=1e-9)


def test_the_filter_is_first_order():
    a = Admittance(AdmittanceSettings(dead_band=1e9, filter_time=0.1), 1)
    a.update([0.0], 1e-4)
    for _ in range(1000):
        a.update([1.0], 1e-4)
    assert a.force[0] == pytest.approx(1 - np.exp(-1.0), abs=1e-3)


def test_bounds_and_dead_band():
    a = Admittance(AdmittanceSettings(damping=1.0, dead_band=2.0, max_speed=0.1, max_offset=0.005), 3)
    a.update([0, 1.9, 0], 0.01)
    assert not a.offset.any()
    a.update([0, 1000.0, 0], 0.01)
    assert 0 < np.linalg.norm(a.offset) <= 0.1 * 0.01 + 1e-12
    for _ in range(100):
        a.update([0, 1000.0, 1000.0], 0.01)
    assert np.linalg.norm(a.offset) == pytest.approx(0.005)


def test_against_a_spring_the_wanted_force_is_reached():
    a, stiffness = Admittance(AdmittanceSettings(damping=2000, dead_band=0.0, max_offset=0.01), 1), 5000.0
    force = 0.0
    for _ in range(3000):
        force = -stiffness * float(a.update([force], 0.002, [8.0])[0])
    assert force == pytest.approx(8.0, abs=0.1)


def test_impossible_settings():
    with pytest.raises(InputError, match="damping"):
        AdmittanceSettings(damping=0)
