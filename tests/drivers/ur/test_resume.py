"""One `resume()`: it makes the cell ready, or says what to do; nothing else moves an arm that was stopped."""

import ast
import threading
import time
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from tests.drivers.ur.emulated import dashboard, emulator, free_hosts, free_port
from tests.drivers.ur.rig import MOVE, one_arm, swing, two_arms
from tests.execution.ungated import execute

import armcell
from armcell.cell import load
from armcell.core import ArmcellError, ErrorCode, InputError
from armcell.drivers import DriverOptions, drivers
from armcell.drivers.ur.arm import UrArm
from armcell.drivers.ur.wire.modes import RobotMode
from armcell.model import load_robot
from armcell.ros import Bus
from armcell.ros.nodes import ServedCell
from armcell.scene import PlanningScene

SRC = Path(armcell.__file__).parent
CELL = """
robot: ur10
start: {{arm: home}}
real:
  twin: false
  backend: {backend}
  max_state_age: 1.0
  watchdog: 0.5
  arms:
    arm: {{host: {host}, port: {port}, model: {model}}}
"""


installed = find_spec("rtde_control") is not None
needs_ur_rtde = pytest.mark.skipif(not installed, reason="ur_rtde is not installed (no wheel for 3.13)")
BACKENDS = ["own", pytest.param("ur_rtde", marks=[needs_ur_rtde, pytest.mark.realtime])]


@pytest.fixture(params=BACKENDS)
def cell(tmp_path, request):
    def made(host, model="UR10"):
        (tmp_path / "cell.yaml").write_text(
            CELL.format(host=host, port=free_port(), model=model, backend=request.param)
        )
        return load(tmp_path)

    return made


def until(condition, seconds=5.0):
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.02)
    assert condition()


def ready(live) -> None:
    """A resume succeeds, moves nothing, and the arm moves again when it is asked to."""
    (arm,) = live.driver.arms.values()
    for _ in range(3):  # a busy machine may stop it anew at any moment
        outcome = live.resume()
        assert outcome.ok, outcome.message
        before = arm.q
        time.sleep(0.3)
        np.testing.assert_allclose(arm.q, before, atol=1e-3)
        result = execute(live.driver, swing(live.driver, arm.joint_names, 0.2 * MOVE, 1.0))
        if result.ok:
            return
    raise AssertionError(result.message)


def refused(live, *words) -> str:
    outcome = live.resume()
    assert not outcome.ok
    for word in words:
        assert word in outcome.message, outcome.message
    assert live.driver.fault() is not None
    return outcome.message


def lags(monkeypatch, arm, seconds: float = 0.2) -> None:
    """The arm's driver still has a state from before the brakes were released, as on a busy machine."""
    old = replace(arm.state, values={**arm.state.values, "robot_mode": RobotMode.IDLE})
    end = time.monotonic() + seconds
    late = property(lambda self: old if time.monotonic() < end else self._rtde.latest)
    monkeypatch.setattr(UrArm, "state", late)


def call_everything(live) -> None:
    """What a program may ask of a cell that has stopped: it answers, or fails with an error of ours."""
    driver, arm = live.driver, live.driver.arms["arm"]
    q, plan = arm.q, swing(driver, arm.joint_names, 0.2 * MOVE, 1.0)
    for call in (
        driver.joint_state, driver.targets, driver.stop, live.scene, driver.object_poses,
        lambda: driver.advance(0.05), lambda: driver.follow(plan), lambda: driver.speed_fraction,
        lambda: driver.command(arm.joint_names, q, 0 * q), lambda: driver.hold(arm.joint_names),
        lambda: arm.servo(q, 0 * q, time.monotonic()), lambda: arm.set_slider(0.5), arm.beat, arm.fault,
        lambda: arm.set_tool_output(0, True), lambda: live.arm.move_to("home"), arm.force, arm.zero_force,
        lambda: arm.clock(1),
    ):  # fmt: skip
        try:
            call()
        except ArmcellError as error:
            assert str(error)


@pytest.mark.slow
def test_stops_that_an_operator_ends(cell, monkeypatch):
    (host,) = free_hosts(1)
    with emulator(hosts=[host]), cell(host).connect("real") as live:
        assert live.resume().ok  # nothing has happened
        dashboard(host, "armcell protective stop")
        until(lambda: live.driver.fault() is not None)
        assert not live.arm.move_to("home").ok
        for _ in range(2):
            refused(live, "'arm'", "protective stop", "unlock it at the pendant", "then call resume() again")
        dashboard(host, "unlock protective stop")
        until(lambda: not (f := live.driver.arms["arm"].fault()) or f.kind != "protective stop")
        ready(live)
        assert live.resume().ok and live.resume().ok

        dashboard(host, "armcell emergency stop")
        until(lambda: live.driver.fault() is not None)
        refused(live, "emergency stop", "release the emergency stop button", "then call resume() again")
        dashboard(host, "armcell emergency release")
        time.sleep(0.3)
        refused(live, "robot mode POWER_OFF", "power on, release brakes", "then call resume() again")
        dashboard(host, "power on", "brake release")
        until(lambda: dashboard(host, "robotmode")[0].endswith("RUNNING"))
        lags(monkeypatch, live.driver.arms["arm"])
        ready(live)


@pytest.mark.realtime
@pytest.mark.slow
def test_a_program_that_was_killed_and_remote_control_that_is_off(cell):
    (host,) = free_hosts(1)
    with emulator("--model", "UR10e", hosts=[host]), cell(host, "UR10e").connect("real") as live:
        dashboard(host, "stop")
        until(lambda: live.driver.fault() is not None)
        assert live.driver.fault().kind == "program ended"
        ready(live)
        dashboard(host, "stop", "armcell local")
        until(lambda: live.driver.fault() is not None)
        refused(live, "'arm'", "local control", "choose Remote Control", "then call resume() again")
        dashboard(host, "armcell remote")
        ready(live)


@pytest.mark.realtime
@pytest.mark.slow
def test_a_link_that_is_lost_and_comes_back(cell):
    """Whatever is called between fails with an error of ours, and says what to do."""
    (host,) = free_hosts(1)
    with emulator(hosts=[host]) as robot, cell(host).connect("real") as live:
        live.driver.follow(swing(live.driver, live.driver.arms["arm"].joint_names, MOVE, 3.0))
        time.sleep(0.5)
        robot.kill()
        robot.wait()
        until(lambda: live.driver.fault() is not None)
        for _ in range(2):
            started = time.monotonic()
            refused(live, "'arm'", f"the link to {host} is lost", "check the cable", "call resume() again")
            assert live.driver.fault().code is ErrorCode.COMMUNICATION_FAILURE
            assert time.monotonic() - started < 30.0
            call_everything(live)
            assert live.driver._heartbeat.beats
        with emulator(hosts=[host]):
            ready(live)


@pytest.mark.realtime
@pytest.mark.slow
def test_one_arm_of_two_that_cannot_resume_keeps_both_stopped():
    hosts = free_hosts(2)
    e_series = {"model": "UR10e"}
    with emulator("--model", "UR10e", hosts=hosts), two_arms(hosts, e_series, e_series) as driver:
        left = driver.arms["left_arm"]
        dashboard(hosts[1], "stop")
        until(lambda: driver.fault() is not None)
        dashboard(hosts[1], "armcell local")
        for _ in range(2):
            with pytest.raises(
                InputError, match=r"arm 'right_arm': .* local control .*call resume\(\) again"
            ):
                driver.resume()
            assert driver.fault() is not None
            rest = left.q
            with pytest.raises(InputError, match="no motion after a stop"):
                driver.follow(swing(driver, left.joint_names, 0.3 * MOVE, 1.0))
            driver.command(left.joint_names, rest + 0.1, 0 * rest)
            time.sleep(0.3)
            np.testing.assert_allclose(left.q, rest, atol=1e-4)
        dashboard(hosts[1], "armcell remote")
        driver.resume()
        assert driver.fault() is None


@pytest.mark.realtime
@pytest.mark.slow
def test_resume_while_it_moves_changes_nothing_and_at_once_after_a_stop_it_holds():
    (host,) = free_hosts(1)
    with emulator(hosts=[host]), one_arm(host) as driver:
        arm = driver.arms["arm"]
        plan = swing(driver, arm.joint_names, MOVE, 2.0)
        moving = driver.follow(plan)
        for _ in range(5):
            time.sleep(0.2)
            driver.resume()
        until(lambda: moving.state() == "done")
        np.testing.assert_allclose(arm.q, plan.positions[-1], atol=5e-3)
        for _ in range(3):  # the old program's end must not end the new one
            moving = driver.follow(
                swing(driver, arm.joint_names, 0.5 * MOVE * np.sign(np.cos(arm.q[0])), 2.0)
            )
            time.sleep(0.4)
            dashboard(host, "stop")
            until(lambda: driver.fault() is not None)
            driver.resume()
            rest = arm.q
            time.sleep(0.8)
            assert driver.fault() is None and moving.state() != "running"
            np.testing.assert_allclose(arm.q, rest, atol=1e-3)


@pytest.mark.realtime
@pytest.mark.slow
def test_a_slider_set_while_the_link_is_lost_is_set_by_the_resume():
    (host,) = free_hosts(1)
    with emulator(hosts=[host]) as robot, one_arm(host) as driver:
        arm = driver.arms["arm"]
        arm.set_slider(0.25)
        until(lambda: abs(arm.state.target_speed_fraction - 0.25) < 1e-3)
        robot.kill()
        robot.wait()
        until(lambda: driver.fault() is not None)
        arm.set_slider(0.5)  # as the twin's guard puts back what it had slowed
        with emulator(hosts=[host]):
            driver.resume()
            until(lambda: abs(arm.state.target_speed_fraction - 0.5) < 1e-3)


def test_real_arms_that_are_not_connected_say_so():
    model = load_robot("ur10")
    real = {"arms": {"arm": {"host": "127.0.0.9", "model": "UR10"}}}
    driver = drivers["real"](PlanningScene.of(model), DriverOptions(extra={"real": real}))
    for call in (driver.resume, driver.joint_state, driver.targets):
        with pytest.raises(InputError, match="not connected"):
            call()


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["sim", "fake"])
@pytest.mark.parametrize("extra", ["", "disturbances: {joint_noise_deg: 0.001}\n", "perception"])
def test_simulated_cells_resume_too(tmp_path, mode, extra):
    text = "robot: panda\nstart: {arm: home}\n"
    if extra == "perception":
        text += (
            "objects:\n  table: {box: [1, 1, 0.02], pose: [0.5, 0, -0.011]}\n"
            "  cube: {box: [0.04, 0.04, 0.04], pose: [0.5, 0, 0.02], movable: true}\n"
            "cameras:\n  top: {eye: [0.9, 0, 0.9], target: [0.5, 0, 0], width: 64, height: 48}\n"
            "perception: {camera: top, objects: [cube], surface: table}\n"
        )
    (tmp_path / "cell.yaml").write_text(text + (extra if ":" in extra else ""))
    with load(tmp_path).connect(mode) as live:
        assert live.resume().ok
        live.stop()
        assert live.arm.move_to("extended").code is ErrorCode.PREEMPTED
        assert live.resume().ok and live.resume().ok
        assert live.arm.move_to("extended").ok


def test_a_resume_at_once_after_a_stop_does_not_undo_the_stop(tmp_path):
    (tmp_path / "cell.yaml").write_text("robot: panda\nstart: {arm: home}\n")
    with load(tmp_path).connect("fake", time_scale=1.0) as live:
        ended = []
        thread = threading.Thread(target=lambda: ended.append(live.arm.move_to("extended")))
        moved = live.driver.joint_state().positions
        thread.start()
        until(lambda: not np.array_equal(live.driver.joint_state().positions, moved), 20.0)
        live.stop()
        assert live.resume().ok
        thread.join(20.0)
        assert ended[0].code is ErrorCode.PREEMPTED
        assert live.arm.move_to("extended").ok


def test_physics_that_has_diverged_does_not_resume():
    with load("panda_pick").connect("sim") as live:
        live.stop()
        live.driver.world.mj_data.qvel[:] = np.nan
        with pytest.raises(ArmcellError, match="diverged"):
            live.driver.advance(0.01)
        outcome = live.resume()
        assert (
            not outcome.ok and "diverged" in outcome.message and "connect the cell again" in outcome.message
        )
        assert live.ctx.cancel.is_set()


def test_no_assert_guards_what_a_driver_may_meet():
    packages = ("drivers", "execution", "twin", "emulators")
    files = [file for package in packages for file in sorted((SRC / package).rglob("*.py"))]
    assert len(files) > 80
    for file in files:
        asserts = [n.lineno for n in ast.walk(ast.parse(file.read_text())) if isinstance(n, ast.Assert)]
        assert not asserts, f"{file}: {asserts}"


@pytest.mark.realtime
@pytest.mark.slow
def test_a_served_cell_resumes_by_a_service(cell):
    (host,) = free_hosts(1)
    bus = Bus()
    with emulator(hosts=[host]), ServedCell(cell(host).connect("real"), bus, plan=False) as served:
        ask = lambda: bus.call("/resume", bus.schema.new("std_srvs/TriggerRequest"))  # noqa: E731
        assert (ask().success, ask().message) == (True, "ready")
        dashboard(host, "armcell protective stop")
        until(lambda: served.live.driver.fault() is not None)
        before = bus.clock.now()
        answer = ask()
        assert not answer.success and "unlock it at the pendant" in answer.message
        dashboard(host, "unlock protective stop")
        until(lambda: ask().success)
        until(lambda: bus.clock.now() > before)  # the cell's thread goes on meanwhile
