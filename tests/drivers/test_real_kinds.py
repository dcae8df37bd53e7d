"""The contract of every kind of real robot, against its emulator. A new kind needs a rig in rigs.py."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest
from tests.drivers.rigs import RIGS
from tests.drivers.test_proxy import OPTIONAL
from tests.drivers.toy_kind import ROBOTS, ToyRobot
from tests.execution.ungated import execute

from armcell.core import ErrorCode, InputError, JointTrajectory, UnknownNameError
from armcell.drivers import Capability, DriverOptions, DriverProxy, drivers
from armcell.drivers.real import kind_of, real_settings, robot_kinds
from armcell.model import MountedRobot, compose, load_robot
from armcell.scene import PlanningScene

SLOW = {"max_state_age": 1.0, "watchdog": 0.5}  # for machines that other programs fill
kinds = pytest.mark.parametrize(
    "kind", [pytest.param(k, marks=() if k == "toy" else pytest.mark.slow) for k in RIGS]
)
backends = pytest.mark.parametrize(
    ("kind", "backend"),
    [
        pytest.param(k, backend, marks=() if k == "toy" else pytest.mark.slow)
        for k in RIGS
        for backend in robot_kinds[k].backends
    ],
)


def made(model, arms, **settings):
    options = DriverOptions(extra={"real": {"arms": arms, **SLOW, **settings}})
    return drivers["real"](PlanningScene.of(model), options)


def of(rig, kind, **settings):
    return made(rig.model, {"arm": {"kind": kind, **rig.block}}, **settings)


def quintic(driver, names, change, duration=1.5):
    """A motion of some joints by `change` [rad], at rest at both ends."""
    q0 = driver.joint_state().reindexed(names).positions
    u = np.linspace(0.0, 1.0, 16)
    s, ds = u**3 * (10 - 15 * u + 6 * u**2), 30 * u**2 * (1 - u) ** 2 / duration
    dds = (60 * u - 180 * u**2 + 120 * u**3) / duration**2
    way = np.full(len(names), change)
    return JointTrajectory(names, u * duration, q0 + np.outer(s, way), np.outer(ds, way), np.outer(dds, way))


def until(true, seconds=5.0):
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_each_installed_kind_has_a_rig():
    assert set(robot_kinds) == set(RIGS), "add the kind's emulator to tests/drivers/rigs.py"


@pytest.mark.slow
@pytest.mark.cases("*-own")
@backends
def test_the_contract_of_a_real_arm(kind, backend):
    try:
        robot_kinds[kind].check_backend(backend)
    except InputError as error:
        pytest.skip(str(error))
    with RIGS[kind]() as rig:
        driver = of(rig, kind, backend=backend)
        names = rig.model.group("arm").joint_names
        with pytest.raises(InputError, match="not connected"):
            driver.joint_state()
        with driver as connected:
            assert connected is driver and not driver.is_simulated and driver.is_paced
            _states(driver, names)
            _capabilities(driver)
            _moves_and_arrives(driver, names)
            _streams(driver, names)
            _wrong_commands(driver, names)
            _stops_and_resumes(driver, rig, names)
        with driver:  # connecting again works
            assert driver.fault() is None


def _states(driver, names):
    before = driver.next_command_time  # up to the computing time since the last advance before `now`
    driver.advance(0.1)
    assert driver.now - before >= 0.1 - driver.period
    state = driver.joint_state()
    assert set(names) <= set(state.joint_names) and np.isfinite(state.positions).all()
    assert np.isfinite(driver.targets().reindexed(names).positions).all()
    assert set(driver.calibrations()) == {"arm"} and driver.safety_events == []


def _capabilities(driver):
    assert Capability.DRY_RUN not in driver.capabilities  # no guard was set
    assert {Capability.PLAY_TRAJECTORY, Capability.ROBOT_CLOCK} <= driver.capabilities
    assert set(driver.arm_modes()) == {"arm"} and 0.0 <= driver.speed_fraction <= 1.0
    for each in (driver, DriverProxy(driver)):
        for capability in OPTIONAL.keys() - driver.capabilities:
            for call in OPTIONAL[capability]:
                with pytest.raises(InputError, match=capability.name):
                    call(each)


def _moves_and_arrives(driver, names):
    for each, change in ((driver, 0.2), (DriverProxy(driver), -0.2)):
        motion = quintic(driver, names, change)
        result = execute(each, motion)
        assert result.ok, result.message
        here = driver.joint_state().reindexed(names).positions
        np.testing.assert_allclose(here, motion.positions[-1], atol=5e-3)


def _streams(driver, names):
    for _ in range(3):  # a busy machine may stop the arm
        motion = quintic(driver, names, 0.1, 1.0)
        began = driver.next_command_time
        while (t := driver.next_command_time - began) < motion.duration:
            q, v, _ = motion.sample(t)
            sent = driver.command(names, q, v)
            assert sent.joint_names == names
            driver.advance(driver.period)
        driver.command(names, motion.positions[-1], np.zeros(len(names)))
        driver.advance(1.0)
        fault = driver.fault()
        if fault is None:
            break
        driver.resume()
    assert fault is None, fault
    here = driver.joint_state().reindexed(names).positions
    np.testing.assert_allclose(here, motion.positions[-1], atol=5e-3)


def _wrong_commands(driver, names):
    here = driver.joint_state().reindexed(names).positions
    with pytest.raises(InputError):
        driver.command(names, here * np.nan, here * 0.0)
    with pytest.raises(InputError, match="all joints of each"):
        driver.command(names[:1], here[:1], [0.0])
    with pytest.raises(UnknownNameError):
        driver.gripper("claw")
    driver.advance(0.2)
    np.testing.assert_allclose(driver.joint_state().reindexed(names).positions, here, atol=2e-3)


def _stops_and_resumes(driver, rig, names):
    motion = quintic(driver, names, 0.3, 3.0)
    handle = driver.follow(motion)
    until(lambda: handle.trajectory_time() > 0.5)
    rig.stop()
    until(lambda: driver.fault() is not None)
    with pytest.raises(InputError, match="no motion after a stop"):
        driver.follow(motion)
    with pytest.raises(InputError, match="cannot resume"):
        driver.resume()
    time.sleep(0.5)
    rest = driver.joint_state().reindexed(names).positions
    driver.command(names, rest + 0.1, np.zeros(len(names)))  # not sent
    driver.advance(0.5)
    np.testing.assert_allclose(driver.joint_state().reindexed(names).positions, rest, atol=2e-3)
    rig.unlock()
    time.sleep(0.5)
    driver.resume()
    assert driver.fault() is None
    assert "resumed" in [event.kind for event in driver.safety_events]
    driver.advance(0.3)
    np.testing.assert_allclose(driver.joint_state().reindexed(names).positions, rest, atol=2e-3)
    assert execute(driver, quintic(driver, names, -0.1)).ok


@kinds
def test_the_constructor_does_nothing_yet(kind, monkeypatch):
    with RIGS[kind]() as rig:
        threads = threading.active_count()
        monkeypatch.delattr("socket.socket")
        of(rig, kind)
        assert threading.active_count() <= threads
        monkeypatch.undo()


@kinds
def test_another_serial_number_is_another_robot(kind):
    with RIGS[kind]() as rig:
        rig.block["serial"] = "another"
        with pytest.raises(InputError, match="serial number"), of(rig, kind):
            pass


@pytest.mark.cases("ur", "toy")
@kinds
def test_the_vendor_s_part_of_the_bring_up(kind):
    with RIGS[kind]() as rig:
        settings = real_settings({"arms": {"arm": {"kind": kind, **rig.block}}}, rig.model)
        arm = settings.arms["arm"]
        assert kind_of(arm) is robot_kinds[kind]
        found = robot_kinds[kind].identify(arm)
        robot_kinds[kind].check_identity("arm", arm, found)
        robot_kinds[kind].check_ready("arm", found)
        assert found.serial in str(found)
        assert "ms" in str(robot_kinds[kind].measure_network(arm))
        assert robot_kinds[kind].power_on("arm", arm) == "was on"
        assert robot_kinds[kind].measured_positions(arm).shape == (robot_kinds[kind].joints,)


# --- the block `real` ---
def pair():
    """Two Pandas as one model, their groups "left_arm" and "right_arm"."""
    return compose("pair", [MountedRobot(load_robot("panda"), f"{side}_") for side in ("left", "right")])


def test_the_default_kind_is_ur_and_an_unknown_one_is_named():
    model = load_robot("ur10")
    assert real_settings({"arms": {"arm": {"host": "127.0.0.9"}}}, model).arms["arm"].kind == "ur"
    with pytest.raises(UnknownNameError, match="kind of real robot 'kuka'.*toy, ur") as error:
        real_settings({"kind": "kuka", "arms": {"arm": {"host": "127.0.0.9"}}}, model)
    assert error.value.element == "real/kind"
    with pytest.raises(UnknownNameError) as error:
        real_settings({"arms": {"arm": {"kind": "kuka", "host": "127.0.0.9"}}}, model)
    assert error.value.element == "real/arms/arm/kind"


@pytest.mark.parametrize(
    ("block", "place"),
    [
        ({"arms": {"arm": {"host": "h", "modle": "UR10"}}}, "real/arms/arm/modle"),
        ({"arms": {"arm": {"kind": "toy", "host": "h", "model": "UR10"}}}, "real/arms/arm/model"),
        ({"arms": {"arm": {"host": ""}}}, "real/arms/arm/host"),
        ({"arms": {"arm": 7}}, "real/arms/arm"),
        ({"arms": {}}, "real/arms"),
        ({"arms": 7}, "real/arms"),
        ({"kind": 7, "arms": {"arm": {"host": "h"}}}, "real/kind"),
        ({"kind": "ur"}, "real/arms"),
        ({"arms": {"arm": {"host": "h"}}, "watchdog": 9}, "real/watchdog"),
        ({"arms": {"arm": {"host": "h"}}, "backend": "franky"}, "real/backend"),
        ({"arms": {"arm": {"host": "h"}}, "speed": 9}, "real/speed"),
    ],
)
def test_a_wrong_block_is_named_by_its_place(block, place):
    with pytest.raises(InputError) as error:
        real_settings(block, load_robot("ur10"))
    assert error.value.element == place


def test_arms_of_a_kind_need_its_number_of_joints():
    with pytest.raises(UnknownNameError, match="group with seven joints"):
        real_settings({"kind": "toy", "arms": {"arm": {"host": "h"}}}, load_robot("ur10"))


def test_two_arms_keep_one_clock_and_stop_together(monkeypatch):
    model = pair()
    home = np.array([0.0, -0.6, 0.0, -2.2, 0.0, 1.6, 0.8])
    for host in ("a", "b"):
        monkeypatch.setitem(ROBOTS, host, ToyRobot(7))
        ROBOTS[host].q, ROBOTS[host].serial = home.copy(), host
    arms = {"left_arm": {"host": "a"}, "right_arm": {"host": "b"}}
    names = tuple(n for g in arms for n in model.group(g).joint_names)
    with made(model, arms, kind="toy") as driver:
        assert driver.calibrations().keys() == arms.keys()
        assert execute(driver, quintic(driver, names, 0.1)).ok
        np.testing.assert_allclose(ROBOTS["a"].q, ROBOTS["b"].q, atol=1e-9)
        handle = driver.follow(quintic(driver, names, 0.3, 3.0))
        until(lambda: handle.trajectory_time() > 0.3)
        ROBOTS["b"].stopped = True
        until(lambda: driver.fault() is not None)
        until(lambda: handle.state() == "cancelled")
        assert driver.fault().arm == "right_arm" and driver.fault().code is ErrorCode.CONTROL_FAILED
        rest = ROBOTS["a"].q.copy()
        driver.advance(0.3)
        assert np.array_equal(ROBOTS["a"].q, rest)
        ROBOTS["b"].stopped = False
        driver.resume()
        assert driver.fault() is None


def test_swapped_addresses_are_noticed(monkeypatch):
    for host in ("a", "b"):
        monkeypatch.setitem(ROBOTS, host, ToyRobot(7))
        ROBOTS[host].serial = host
    arms = {"left_arm": {"host": "a", "serial": "b"}, "right_arm": {"host": "b", "serial": "a"}}
    with pytest.raises(InputError, match="the arms are swapped"), made(pair(), arms, kind="toy"):
        pass
