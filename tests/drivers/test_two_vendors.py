"""Mode real with a Panda and a UR10e: one driver, one supervisor; a bar goes from hand to hand in physics."""

from __future__ import annotations

import json
import time
from contextlib import contextmanager

import numpy as np
import pytest
from tests.drivers.franka.emulated import emulators, free_host, operate
from tests.drivers.test_real_kinds import quintic, until
from tests.drivers.ur.emulated import dashboard, free_hosts, free_port, in_real_time
from tests.execution.ungated import execute

from armcell.cell import load, run_task, with_values
from armcell.cell.built_in import LIBRARY
from armcell.cli.main import main
from armcell.core import InputError, JointTrajectory, UnknownNameError
from armcell.drivers.real import RealDriver, real_settings
from armcell.drivers.safety import Fault
from armcell.planning import warm_up

CELL = "panda_ur10e_handover"


def block(**arms):
    return {
        "arms": {
            "franka_arm": {"kind": "franka", "host": "127.0.0.3"},
            "ur_arm": {"host": "127.0.0.2"},
            **arms,
        }
    }


def test_each_arm_has_its_own_kind_and_backend():
    model = load(CELL).model
    settings = real_settings({"kind": "franka", **block(ur_arm={"kind": "ur", "host": "127.0.0.2"})}, model)
    assert [(a.kind, a.backend) for a in settings.arms.values()] == [("franka", "own"), ("ur", "own")]
    ur = {"host": "127.0.0.2", "backend": "ur_rtde"}
    settings = real_settings(block(ur_arm=ur), model)
    assert [(a.kind, a.backend) for a in settings.arms.values()] == [("franka", "own"), ("ur", "ur_rtde")]
    with pytest.raises(UnknownNameError, match="backend of kind 'franka' 'ur_rtde'") as error:
        real_settings({"backend": "ur_rtde", **block()}, model)
    assert error.value.element == "real/backend"
    with pytest.raises(UnknownNameError, match="backend of kind 'ur' 'franky'") as error:
        real_settings(block(ur_arm={"host": "127.0.0.2", "backend": "franky"}), model)
    assert error.value.element == "real/arms/ur_arm/backend"
    with pytest.raises(UnknownNameError, match="six joints.*franka_arm"):
        real_settings({"arms": {"franka_arm": {"host": "127.0.0.3"}}}, model)
    with pytest.raises(InputError, match="same address"):
        real_settings(block(ur_arm={"host": "127.0.0.3"}), model)


@contextmanager
def emulated(seed: int = 0):
    """Both emulated controllers in a process of their own: the cell with their addresses, and these."""
    franka, (ur,) = free_host(), free_hosts(1)
    values: dict[str, object] = {
        "real.arms.franka_arm.host": franka,
        "real.arms.ur_arm.host": ur,
        "real.arms.ur_arm.port": free_port(),
    }
    given = [word for key, value in values.items() for word in ("--set", f"{key}={value}")]
    # Wide, for machines that other programs fill; the defaults are 0.05, 1 and 0.1 s.
    wide = {"real.max_state_age": 0.3, "real.max_silence": 3.0, "real.watchdog": 0.5}
    with emulators("emulate", CELL, "--seed", str(seed), *given, host=franka):
        yield with_values(load(CELL), {**values, **wide}), franka, ur


@pytest.mark.slow
@pytest.mark.realtime
def test_the_panda_hands_the_bar_to_the_ur10e():
    warm_up()
    for _ in range(3):  # a computer that stands still for 100 ms, as busy virtual ones do, stops the arms
        with emulated() as (cell, franka, ur):
            with in_real_time(), cell.connect("real", 0) as live:
                result = run_task(cell, live, 0, "real")
            (pose,) = dashboard(ur, "armcell pose bar")
            (messages,), state = dashboard(ur, "armcell messages"), operate(franka, "state")
        if result["success"]:
            break
    assert result["success"], result["message"]
    assert {s["name"] for s in result["stages"]} >= {"bring to the other arm", "yield"}
    assert "protective stop" not in messages and state.split()[:2] == ["IDLE", "-"]
    tray = load(CELL).scene(0).object("tray").T_world_object.translation
    assert np.linalg.norm(np.array(pose.split()[:2], dtype=float) - tray[:2]) < 0.005  # by physics itself


def _under_way(driver: RealDriver, motion: JointTrajectory) -> None:
    handle = driver.follow(motion)
    until(lambda: (handle.trajectory_time() or 0.0) > 0.5)


def _stopped(driver: RealDriver) -> Fault:
    until(lambda: driver.fault() is not None)
    fault = driver.fault()
    assert fault is not None
    return fault


@pytest.mark.slow
@pytest.mark.realtime
@pytest.mark.parametrize("victim", ["franka", "ur"])
def test_a_fault_of_one_vendor_stops_the_other(victim):
    stops = {
        "franka": (lambda f, u: operate(f, "user stop on"), lambda f, u: operate(f, "user stop off")),
        "ur": (
            lambda f, u: dashboard(u, "armcell protective stop"),
            lambda f, u: dashboard(u, "unlock protective stop"),
        ),
    }
    stop, undo = stops[victim]
    with emulated() as (cell, franka, ur), in_real_time(), cell.connect("real", 0) as live:
        driver = live.driver
        assert isinstance(driver, RealDriver)
        arms = [arm.joint_names for arm in driver.arms.values()]
        names = tuple(n for arm in arms for n in arm)
        assert execute(driver, quintic(driver, names, 0.1)).ok
        for moving in (names, *arms):
            _under_way(driver, quintic(driver, moving, 0.2, 4.0))
            stop(franka, ur)
            assert _stopped(driver).arm == f"{victim}_arm"
            time.sleep(0.5)
            rest = driver.joint_state().reindexed(names).positions
            with pytest.raises(InputError, match="no motion after a stop"):
                driver.follow(quintic(driver, names, 0.1))
            with pytest.raises(InputError, match="cannot resume"):
                driver.resume()
            driver.advance(0.3)
            np.testing.assert_allclose(driver.joint_state().reindexed(names).positions, rest, atol=2e-3)
            undo(franka, ur)
            time.sleep(0.5)
            driver.resume()
            np.testing.assert_allclose(driver.joint_state().reindexed(names).positions, rest, atol=2e-3)
            assert execute(driver, quintic(driver, names, -0.05)).ok
        kinds = [event.kind for event in driver.safety_events]
        assert kinds.count("peer stopped") >= 3 and kinds.count("resumed") >= 3


@pytest.mark.slow
@pytest.mark.realtime
def test_bring_up_and_learned_twin_of_both(tmp_path, capsys):
    with emulated() as (_, franka, ur):
        (tmp_path / CELL).mkdir()
        source = LIBRARY / CELL
        text = (source / "cell.yaml").read_text().replace("127.0.0.3", franka).replace("127.0.0.2", ur)
        text += "  max_state_age: 0.3\n  watchdog: 0.5\n"
        text = text.replace("model: UR10e", f"port: {free_port()}, model: UR10e")
        (tmp_path / CELL / "cell.yaml").write_text(text)
        (tmp_path / CELL / "task.py").write_text((source / "task.py").read_text())
        record = tmp_path / "bringup.json"
        status = main(["bringup", str(tmp_path / CELL), "--yes", "--record", str(record)])
        steps = json.loads(record.read_text())["steps"]
        assert status == 0, steps
        assert {(s["name"], s["arm"]) for s in steps} >= {
            (name, arm) for name in ("geometry", "joints", "line") for arm in ("franka_arm", "ur_arm")
        }
        assert main(["twin", str(tmp_path / CELL), "--yes", "--motions", "3"]) == 0, capsys.readouterr().err
        told = capsys.readouterr().out
        assert "Nm, load" in told and " A, load" in told  # torques of one, currents of the other
        with load(tmp_path / CELL).connect("real") as live:
            assert live.driver.guard is not None and live.driver.guard.compares
