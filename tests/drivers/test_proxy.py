"""DriverProxy forwards every member of Driver; what a driver cannot do says so."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import numpy as np
import pytest
from tests.execution.helpers import ARM, GRIPPER, make, scene, swing

import armcell
from armcell.core import InputError, Playback
from armcell.drivers import Capability, Driver, DriverProxy, drivers
from armcell.execution import ArmDriver, CooperativeScheduler
from armcell.ros.nodes.motion_queue import MotionQueue

MEMBERS = {n for n in {*vars(Driver), *inspect.get_annotations(Driver)} if not n.startswith("_")}
OPTIONAL = {  # capability -> a call of each of its members
    Capability.PLAY_TRAJECTORY: [lambda d: d.follow(swing())],
    Capability.PLAY_PARTS: [lambda d: d.play(ARM, Playback(swing()), d.now, 0.02, 0.1)],
    Capability.DRY_RUN: [lambda d: d.dry_run(swing()), lambda d: d.monitor_execution(swing(), False)],
    Capability.ROBOT_CLOCK: [lambda d: d.latency, lambda d: d.next_command_time, lambda d: d.speed_fraction],
    Capability.REPORT_MODES: [lambda d: d.arm_modes()],
}


def wrappers(driver):
    return [
        DriverProxy(driver),
        MotionQueue(driver),
        ArmDriver(CooperativeScheduler(driver, ["arm"]), "arm", ARM),
        DriverProxy(DriverProxy(driver)),
    ]


def test_a_proxy_has_each_member_of_a_driver_itself():
    missing = {name for name in MEMBERS if name not in vars(DriverProxy)}
    assert not missing, f"DriverProxy would answer these itself instead of asking its driver: {missing}"


def test_each_call_reaches_the_driver_with_its_arguments_and_result():
    heard = []

    class Asked:
        """Stands for a driver; answers every call with the call."""

        def __getattribute__(self, name):
            heard.append(name)
            return lambda *args: (name, args)

    proxy = DriverProxy(Asked())
    for name in MEMBERS - {"capabilities"}:
        member = inspect.getattr_static(DriverProxy, name)
        if isinstance(member, property):
            assert getattr(proxy, name)("x") == (name, ("x",))
            continue
        count = len(inspect.signature(member).parameters) - 1
        given = tuple(range(count))
        answer = getattr(proxy, name)(*given)
        nothing = inspect.signature(member).return_annotation == "None"
        assert answer == (None if nothing else (name, given)) and heard[-1] == name


@pytest.mark.parametrize("name", ["sim", "fake"])
def test_what_a_wrapper_offers_its_driver_can_do(name):
    with make(name) as driver:
        for wrapper in wrappers(driver):
            assert wrapper.capabilities == driver.capabilities - {Capability.PLAY_PARTS}
            assert wrapper.world is driver.world and wrapper.lock is driver.lock
            assert np.array_equal(wrapper.joint_state().positions, driver.joint_state().positions)
            assert wrapper.wrench(GRIPPER.name).shape == (6,)


@pytest.mark.parametrize("name", [n for n in drivers if n != "real"])
def test_what_a_driver_does_not_offer_is_refused_by_its_name(name):
    with make(name) as driver:
        for each in [driver, *wrappers(driver)]:
            for capability, calls in OPTIONAL.items():
                for call in calls:
                    if capability in driver.capabilities:
                        call(driver)
                        continue
                    with pytest.raises(InputError, match=capability.name):
                        call(each)


def test_a_held_arm_stops_and_the_other_joints_go_on():
    with make("sim") as driver:
        for k in range(50):
            q = scene().state.reindexed(ARM).positions.copy()
            q[:2] += 0.004 * k
            driver.command(ARM, q, np.zeros(len(ARM)))
            driver.advance(driver.period)
        driver.hold(ARM[:1])
        before = driver.targets()
        assert before[ARM[1]] == pytest.approx(q[1]) and before[ARM[0]] < q[0]


def test_nothing_forwards_what_it_does_not_name_and_nothing_asks_for_a_class_of_driver():
    folders = ("cell", "execution", "tasks", "twin", "ros/nodes", "records", "campaigns", "viewer", "cli")
    root = Path(armcell.__file__).parent
    found = []
    for file in (f for folder in folders for f in (root / folder).rglob("*.py")):
        text = file.read_text(encoding="utf-8")
        if re.search(r"return getattr\(self\._\w+, name\)", text):
            found.append(f"{file}: forwards by __getattr__")
        if re.search(r"isinstance\([^)]*(Driver|SteppedSim|DisturbedSim)\b", text):
            found.append(f"{file}: asks for a class of driver")
    assert not found
