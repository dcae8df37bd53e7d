"""Two real arms: what is refused with cause and hint before anything moves; and their bring-up."""

import json

import numpy as np
import pytest
from tests.drivers.ur.emulated import dashboard, emulator, free_hosts, free_port, in_real_time
from tests.drivers.ur.rig import MOVE, pair, swing, two_arms
from tests.execution.ungated import execute_coupled

from armcell.cell.built_in import LIBRARY
from armcell.cli.main import main
from armcell.core import ErrorCode, InputError
from armcell.drivers import DriverOptions, drivers
from armcell.drivers.ur.identity import identify
from armcell.scene import PlanningScene


def test_a_simulated_clock_is_refused():
    arms = {"left_arm": {"host": "127.0.0.9"}}
    options = DriverOptions(time_scale=0.5, extra={"real": {"arms": arms}})
    with pytest.raises(InputError, match="a real robot has its own clock") as caught:
        drivers["real"](PlanningScene.of(pair()), options)
    assert "slider" in (caught.value.hint or "")


@pytest.mark.realtime
@pytest.mark.slow
def test_arms_swapped_are_known_by_calibration():
    hosts = free_hosts(2)
    with emulator("--calibration", "3", hosts=hosts):
        left, right = (identify(h).calibration for h in hosts)
        assert left != right
        swapped = two_arms(hosts, {"calibration": right}, {"calibration": left})
        with pytest.raises(InputError, match="the arms are swapped") as caught, swapped:
            pass
        assert "exchange the addresses" in str(caught.value)
        with two_arms(hosts, {"calibration": left}, {"calibration": right}) as driver:
            assert driver.fault() is None


@pytest.mark.realtime
@pytest.mark.slow
def test_one_arm_pushed_by_hand_stops_a_coupled_motion_before_it_begins():
    hosts = free_hosts(2)
    with emulator(hosts=hosts), two_arms(hosts) as driver:
        joints = [n for a in driver.arms.values() for n in a.joint_names]
        plan = swing(driver, joints, [*MOVE, *-MOVE], 2.0)
        dashboard(hosts[1], "armcell move joint 1 -0.04")
        driver.advance(0.3)
        before = [arm.q for arm in driver.arms.values()]
        result = execute_coupled(driver, plan)
        assert result.code is ErrorCode.CONTROL_FAILED
        assert "right_shoulder_lift_joint is 0.040 from the trajectory's start" in result.message
        driver.advance(0.3)
        for arm, q in zip(driver.arms.values(), before, strict=True):
            np.testing.assert_allclose(arm.q, q, atol=1e-6)


@pytest.mark.slow
@pytest.mark.realtime
def test_a_protective_stop_in_a_coupled_motion_ends_it_for_both():
    hosts = free_hosts(2)
    with emulator(hosts=hosts), in_real_time(), two_arms(hosts) as driver:
        joints = [n for a in driver.arms.values() for n in a.joint_names]
        stopped = []

        def in_the_way(fraction: float) -> None:
            if fraction > 0.4 and not stopped:
                stopped.append(dashboard(hosts[0], "armcell protective stop"))

        result = execute_coupled(driver, swing(driver, joints, [*MOVE, *-MOVE], 2.0), progress=in_the_way)
        assert not result.ok and "left_arm: protective stop" in result.message
        driver.advance(0.4)
        there = [arm.q for arm in driver.arms.values()]
        driver.command(tuple(joints), np.zeros(12), np.zeros(12))  # after a stop nothing is sent
        driver.advance(0.4)
        for arm, q in zip(driver.arms.values(), there, strict=True):
            np.testing.assert_allclose(arm.q, q, atol=1e-5)


@pytest.mark.slow
@pytest.mark.realtime
def test_bring_up_of_two_arms(tmp_path, capsys):
    hosts = free_hosts(2)
    text = (LIBRARY / "dual_ur10" / "cell.yaml").read_text()
    for old, new in zip(("127.0.0.2", "127.0.0.3"), hosts, strict=True):
        text = text.replace(f"host: {old},", f"host: {new}, port: {free_port()},")
    text = text.replace("real:\n", "real:\n  max_state_age: 0.3\n  watchdog: 0.5\n")
    file, record = tmp_path / "cell.yaml", tmp_path / "bringup.json"
    file.write_text(text)
    with emulator("--cell", "dual_ur10", "--off", "--calibration", "4", hosts=hosts), in_real_time():
        status = main(["bringup", str(file), "--yes", "--record", str(record)])
        messages = [dashboard(h, "armcell messages")[0] for h in hosts]
    steps = json.loads(record.read_text())["steps"]
    assert status == 0, steps
    both = ["left_arm", "right_arm"]
    assert [(s["name"], s["arm"]) for s in steps] == [
        *(("network", a) for a in both), ("identity", "all"), *(("power", a) for a in both),
        *(("geometry", a) for a in both), *(("joints", a) for a in both), *(("line", a) for a in both),
        ("together", "all"),
    ]  # fmt: skip
    assert all(s["outcome"] == "done" for s in steps)
    assert "all arms moved and came back" in steps[-1]["text"]
    assert not any("protective" in m for m in messages)
