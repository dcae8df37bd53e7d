"""What a cell says is wrong with its robot really acts in physics: against pinocchio, Newton and delays."""

from __future__ import annotations

import numpy as np
import pytest
from tests.cli.helpers import cell_file
from tests.model.helpers import PinRobot, pin_library

from armcell.cell import load, parsed, with_values
from armcell.core import InputError, UnknownNameError
from armcell.kinematics import kinematic_tree

CELL = """robot: panda
start: {arm: home}
physics: {gravity: [0, 0, 0], full_gain_effort: 1.0}
objects:
  block: {box: [0.1, 0.1, 0.1], pose: [0.9, 0.9, 1.5], movable: true, mass: 0.5}
task: [{move: extended}]
"""
HAND = "panda_hand"


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    return load(cell_file(tmp_path_factory.mktemp("cell"), CELL))


@pytest.fixture(scope="module")
def reference(cell):
    return PinRobot(pin_library("panda"), cell.model)


def hand(reference, model, q):
    """Pinocchio's T_world_hand."""
    reference.place(kinematic_tree(model).full_positions(q))
    return reference.pose(HAND)


def test_a_joint_offset_shifts_the_tip_as_forward_kinematics_says(cell, reference):
    off = with_values(cell, {"disturbances.joint_offset_deg.panda_joint2": 2.0})
    column = cell.model.columns(["panda_joint2"])[0]
    for varied, offset in ((cell, 0.0), (off, np.deg2rad(2.0))):
        with varied.connect("sim", 0) as live:
            for target in (None, "extended"):
                if target:
                    assert live.arm.move_to(target)
                told = live.driver.joint_state().positions  # what the encoders say
                true = told.copy()
                true[column] += offset
                want = hand(reference, cell.model, true)
                got = live.driver.world.link_pose(HAND).matrix
                np.testing.assert_allclose(got, want, atol=1e-6)
                shift = np.linalg.norm(want[:3, 3] - hand(reference, cell.model, told)[:3, 3])
                assert (shift > 0.01) == bool(offset)
            goal = cell.model.named_state("arm", "extended")
            np.testing.assert_allclose(  # the task went where its encoders say that it is
                live.driver.joint_state().reindexed(goal.joint_names).positions, goal.positions, atol=0.005
            )


def ramp(cell, steps=60):
    """True positions of the arm at each period of a ramp of joint 4."""
    with cell.connect("sim", 0) as live:
        driver, rows = live.driver, []
        q = driver.joint_state()
        for k in range(steps):
            positions = q.positions.copy()
            positions[3] += 0.002 * k
            driver.command(q.joint_names[:7], positions[:7], np.zeros(7))
            driver.advance(driver.period)
            rows.append(driver.world.joint_state().positions)
        return np.array(rows), driver.period


def test_latency_delays_the_same_motion(cell):
    now, period = ramp(cell)
    later, _ = ramp(with_values(cell, {"disturbances.latency": 10 * period}))
    np.testing.assert_allclose(later[10:, 3], now[:-10, 3], atol=1e-6)
    assert np.abs(later[:, 3] - now[:, 3]).max() > 0.01


def test_noise_has_its_deviation_and_does_not_move_the_arm(cell):
    noisy = with_values(cell, {"disturbances.joint_noise_deg": 0.1})
    with noisy.connect("sim", 3) as live:
        rows, true = [], []
        for _ in range(300):
            live.driver.advance(live.driver.period)
            rows.append(live.driver.joint_state().positions[:7])
            true.append(live.driver.world.joint_state().positions[:7])
            np.testing.assert_array_equal(rows[-1], live.driver.joint_state().positions[:7])
    error = np.array(rows) - np.array(true)
    assert np.ptp(np.array(true), axis=0).max() < 1e-4
    assert np.std(error) == pytest.approx(np.deg2rad(0.1), rel=0.05)  # 2100 draws: 1.5 % is one deviation
    assert np.abs(np.corrcoef(error.T) - np.eye(7)).max() < 0.25


def test_a_push_changes_momentum_as_newton_says(cell):
    pushed = with_values(
        cell,
        {"disturbances.pushes.bump": {"on": "block", "at": 0.101, "duration": 0.05, "force": [0, 4, -2]}},
    )
    with pushed.connect("sim", 0) as live:
        for until, share in ((0.1, 0.0), (0.126, 0.5), (0.2, 1.0), (0.4, 1.0)):
            live.driver.advance(until - live.driver.now)
            velocity = live.driver.world.object_twist("block")[:3]
            want = share * np.array([0.0, 4.0, -2.0]) * 0.05 / 0.5
            np.testing.assert_allclose(velocity, want, atol=0.02 if share == 0.5 else 1e-3)


def test_a_pushed_arm_gives_way_by_its_gains(cell, reference):
    """At rest under a force the servo's torque is J^T F, so with the gain kp a joint is J^T F / kp away."""
    force = np.array([0.0, 20.0, 10.0])
    push = {"on": HAND, "at": 0.0, "duration": 10.0, "force": force.tolist()}
    for kp in (5000.0, 2500.0):
        pushed = with_values(cell, {"disturbances.pushes.lean": push, "physics.arm_kp": kp})
        with pushed.connect("sim", 0) as live:
            start = live.driver.joint_state().positions[:7]
            live.driver.advance(3.0)
            moved = live.driver.joint_state().positions
            world = live.driver.world
        reference.place(kinematic_tree(cell.model).full_positions(moved))
        J = reference.jacobian(HAND)[:, :7]
        arm = world.mj_data.xipos[world.built.body[HAND]] - reference.pose(HAND)[:3, 3]
        torque = J[:3].T @ force + J[3:].T @ np.cross(arm, force)  # the force acts at the centre of mass
        np.testing.assert_allclose(moved[:7] - start, torque / kp, atol=3e-5)


def test_what_is_wrong_is_named(cell):
    far = {"at": 0, "duration": 1, "force": [0, 0, 1]}
    for path, value, told in (
        ("disturbances.joint_offset_deg.panda_join2", 1.0, "did you mean 'panda_joint2'"),
        ("disturbances.joint_offset_deg.panda_finger_joint1", 1.0, "panda_finger_joint1"),
        ("disturbances.latncy", 1.0, "did you mean 'latency'"),
        ("disturbances.latency", -1.0, "latency"),
        ("disturbances.pushes.bump", {"on": "panda_hnd", **far}, "panda_hand"),
        ("disturbances.pushes.bump", {"on": "block", "duraton": 1, **far}, "duration"),
        ("disturbances.pushes.lean.force.x", 1.0, "unknown parameter"),
        ("disturbance.latency", 1.0, "did you mean 'disturbances.latency'"),
        ("physics.arm_kq", 1.0, "did you mean 'arm_k"),
        ("phisics.arm_kp", 1.0, "did you mean 'physics.arm_kp'"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=told):
            with_values(cell, {path: value})
    path, value = parsed("disturbances.pushes.bump={on: block, at: 0, duration: 1, force: [0, 0, 1]}")
    assert with_values(cell, {path: value}).disturbances.pushes[0].on == "block"  # `on` is no boolean here
    with pytest.raises(UnknownNameError, match="did you mean 'disturbances.pushes.bump.force'"):
        push = {"on": "block", "at": 0, "duration": 1, "force": [0, 0, 1]}
        once = with_values(cell, {"disturbances.pushes.bump": push})
        assert with_values(once, {"disturbances.pushes.bump.force.y": 3}).disturbances.pushes[0].force[1] == 3
        with_values(once, {"disturbances.pushes.bumb.force.y": 3})
