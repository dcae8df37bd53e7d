"""Controllers of the arm joints: their laws against formulas, step responses, sag."""

from __future__ import annotations

import numpy as np
import pytest
from tests.cli.helpers import call, read_json

import armcell
from armcell.core import InputError, UnknownNameError
from armcell.sim import PhysicsSettings, SimWorld
from armcell.sim.gain_files import with_gains
from armcell.sim.step_response import sag, step_responses

STEP = 0.1


@pytest.fixture(scope="module")
def scene():
    return armcell.load("dual_ur10").scene()


def ramp_lag(scene, settings, speed=0.3, seconds=1.0):
    """How far a joint is behind its target while that moves at an even speed."""
    world, name = SimWorld(scene, settings), "left_wrist_1_joint"
    start, steps = scene.state[name], round(seconds / settings.timestep)
    for i in range(steps):
        world.set_arm_target((name,), [start + speed * (i + 1) * settings.timestep], [speed])
        world.step()
    return start + speed * steps * settings.timestep - world.joint_state()[name]


def test_a_position_servo_lags_by_its_gains_ratio_and_pid_does_not(scene):
    lag = ramp_lag(scene, with_gains(PhysicsSettings(), "position", scene.model))
    assert lag == pytest.approx(0.3 * 501 / 5000, rel=0.02)  # kv / kp times the speed, joint damping 1 added
    assert abs(ramp_lag(scene, PhysicsSettings())) < 1e-3
    assert abs(ramp_lag(scene, with_gains(PhysicsSettings(), "firm", scene.model))) < 6e-3


def test_torque_is_the_pid_law(scene):
    settings = with_gains(PhysicsSettings(), "firm", scene.model)
    world, name = SimWorld(scene, settings), "right_elbow_joint"
    start = scene.state[name]
    integral = 0.0
    for _ in range(5):
        q, v = world.joint_state()[name], world.joint_state().velocities[world.robot.columns((name,))[0]]
        world.set_arm_target((name,), [start + 0.01], [0.0])
        integral += 500.0 * (start + 0.01 - q) * settings.timestep
        world.step()
        expected = 4000.0 * (start + 0.01 - q) - 200.0 * v + integral
        applied = world.mj_data.actuator(name).force[0]
        assert applied == pytest.approx(expected, rel=1e-9)


def test_the_integral_takes_away_what_gravity_leaves(scene):
    """Without gravity compensation a PD arm sags and stays there; with an integral it comes back."""
    joint = "left_elbow_joint"
    errors = {}
    for ki in (0.0, 2000.0):
        s = PhysicsSettings(
            arm_control="torque", arm_kp=4000, arm_kv=200, arm_ki=ki, gravity_compensation=0.0
        )
        world = SimWorld(scene, s)
        world.step(2500)
        errors[ki] = abs(world.joint_state()[joint] - scene.state[joint])
    assert errors[0.0] > 1e-3 and errors[2000.0] < 0.3 * errors[0.0]


@pytest.mark.parametrize("gains", [None, "firm", "position", "tutorial"])
def test_no_sag_at_the_start(scene, gains):
    settings = PhysicsSettings() if gains is None else with_gains(PhysicsSettings(), gains, scene.model)
    assert max(sag(scene, settings, 0.5).values()) < 1e-4


def test_without_compensation_soft_gains_sag(scene):
    soft = with_gains(PhysicsSettings(gravity_compensation=0.0), "tutorial", scene.model)
    assert max(sag(scene, soft, 1.0).values()) > 0.1


def test_good_gains_settle_and_the_tutorial_s_do_not(scene):
    joints = ("left_shoulder_lift_joint", "left_wrist_3_joint")
    for r in step_responses(scene, joints, PhysicsSettings(), STEP, 1.5):
        assert r.settling_time < 1.0 and r.overshoot < 0.05 and r.final_error < 1e-3
    bad = step_responses(
        scene, joints[:1], with_gains(PhysicsSettings(), "tutorial", scene.model), STEP, 1.5
    )[0]
    assert bad.overshoot > 0.3 and not np.isfinite(bad.settling_time)


def test_measures_of_a_known_curve():
    from armcell.sim.step_response import _measured

    times = np.arange(0, 5, 1e-3)
    r = _measured("j", 0.2, times, 0.2 * (1 - np.exp(-times)))  # first order, time constant 1 s
    assert r.rise_time == pytest.approx(np.log(9), abs=2e-3)
    assert r.settling_time == pytest.approx(np.log(50), abs=2e-3)
    assert r.overshoot == 0.0 and r.final_error == pytest.approx(0.2 * np.exp(-5), rel=0.01)


def test_a_snapshot_brings_the_integral_back(scene):
    settings = with_gains(PhysicsSettings(), "firm", scene.model)
    world = SimWorld(scene, settings)
    world.set_arm_target(("left_elbow_joint",), [scene.state["left_elbow_joint"] + 0.05])
    world.step(50)
    kept = world.snapshot()
    world.step(50)
    first = world.joint_state().positions
    world.restore(kept)
    world.step(50)
    assert np.array_equal(world.joint_state().positions, first)


WRONG = {
    "no such set": ("fim", UnknownNameError, "firm"),
    "unknown gain": ("arm_kd: 3", UnknownNameError, "arm_kd"),
    "not a number": ("arm_kp: high", InputError, "a number is needed"),
    "integral of a servo": ("arm_control: position\narm_ki: 3", InputError, "arm_ki"),
    "unknown control": ("arm_control: magic", InputError, "magic"),
}


@pytest.mark.parametrize(("text", "error", "words"), WRONG.values(), ids=WRONG)
def test_wrong_gains(tmp_path, scene, text, error, words):
    gains = text
    if ":" in text:
        gains = tmp_path / "g.yaml"
        gains.write_text(text + "\n")
    with pytest.raises(error, match=words):
        with_gains(PhysicsSettings(), gains, scene.model)


@pytest.mark.long
def test_the_command(capsys, tmp_path):
    png, numbers = tmp_path / "r.png", tmp_path / "r.json"
    assert call(capsys, "step-response", "dual_ur10", "--plot", png, "--json", numbers).status == 0
    assert png.read_bytes().startswith(b"\x89PNG") and len(read_json(numbers)) == 12
    said = call(capsys, "step-response", "dual_ur10", "--gains", "tutorial", "--group", "right_arm")
    assert said.status == 1 and "never" in said.out and "left_" not in said.out
