"""Motions of the emulated Franka arm: what clients command and what physics does."""

from __future__ import annotations

import numpy as np
import pytest
from tests.emulators.franka.rig import Rig

from armcell.drivers.franka.wire.commands import MoveController, MoveGenerator, MoveStatus, RecoveryStatus
from armcell.drivers.franka.wire.state import RobotCommand, RobotMode

ARM = np.array([0.3, 0.1, -0.2, 0.2, 0.3, -0.2, 0.3])


def swing(t: float, duration: float) -> tuple[float, float]:
    """Position and speed of a smooth motion from 0 to 1."""
    t = min(t, duration)
    w = np.pi / duration
    return 0.5 * (1 - np.cos(w * t)), 0.5 * w * np.sin(w * t)


@pytest.mark.slow
@pytest.mark.cases("0")
@pytest.mark.parametrize("controller", [MoveController.JOINT_IMPEDANCE, MoveController.CARTESIAN_IMPEDANCE])
def test_joint_positions_are_tracked(controller):
    rig = Rig()
    start = rig.robot.q

    def answer(state, t):
        q = start + ARM * swing(t, 1.0)[0]
        return RobotCommand(state.time, q=tuple(q), motion_finished=t >= 1.0)

    rig.start(MoveGenerator.JOINT_POSITION, controller)
    rig.run(answer, 1100)
    assert rig.answers == [MoveStatus.STARTED, MoveStatus.SUCCESS]
    rig.idle(200)
    assert np.abs(rig.robot.q - start - ARM).max() < 1e-4
    assert np.abs(rig.state["q"] - rig.plant.read()[0]).max() < 1e-6


@pytest.mark.slow
def test_joint_velocities_are_integrated():
    rig = Rig()
    start = rig.robot.q
    rig.start(MoveGenerator.JOINT_VELOCITY)
    rig.run(
        lambda state, t: RobotCommand(
            state.time, dq=tuple(ARM * swing(t, 1.0)[1] * (t < 1.0)), motion_finished=t >= 1.0
        ),
        1100,
    )
    assert rig.answers[-1] is MoveStatus.SUCCESS
    rig.idle(200)
    assert np.abs(rig.robot.q - start - ARM).max() < 2e-3


@pytest.mark.slow
@pytest.mark.cases("True")
@pytest.mark.parametrize("elbow", [False, True])
def test_cartesian_poses_move_the_end_effector(elbow):
    rig = Rig()
    T = rig.state["O_T_EE_c"]
    flip = rig.state["elbow_c"][1]

    def answer(state, t):
        x = T.copy()
        x[12:15] += np.array([0.05, 0.08, -0.06]) * swing(t, 1.0)[0]
        angle = 0.2 * swing(t, 1.0)[0]
        return RobotCommand(
            state.time, O_T_EE=tuple(x), elbow=(angle, flip), valid_elbow=elbow, motion_finished=t >= 1.0
        )

    rig.start(MoveGenerator.CARTESIAN_POSITION)
    rig.run(answer, 1100)
    assert rig.answers[-1] is MoveStatus.SUCCESS, rig.texts
    rig.idle(200)
    moved = rig.state["O_T_EE"] - T
    assert np.abs(moved[12:15] - (0.05, 0.08, -0.06)).max() < 2e-4
    assert np.abs(moved[:12]).max() < 1e-3
    hand = rig.plant.world.link_pose("panda_hand_tcp").translation
    assert np.abs(hand - rig.state["O_T_EE"][12:15]).max() < 1e-5
    if elbow:
        assert abs(rig.robot.q[2] - 0.2) < 1e-3


@pytest.mark.slow
def test_a_cartesian_velocity_turns_the_end_effector():
    rig = Rig()
    before = rig.robot.O_T_EE.copy()
    rig.start(MoveGenerator.CARTESIAN_VELOCITY, MoveController.CARTESIAN_IMPEDANCE)
    twist = np.array([0.0, 0.05, 0.0, 0.0, 0.0, 0.3])
    rig.run(
        lambda state, t: RobotCommand(
            state.time, O_dP_EE=tuple(twist * swing(t, 1.0)[1] * (t < 1.0)), motion_finished=t >= 1.0
        ),
        1100,
    )
    assert rig.answers[-1] is MoveStatus.SUCCESS, rig.texts
    rig.idle(300)
    after = rig.robot.O_T_EE
    assert abs(after[1, 3] - before[1, 3] - 0.05) < 1e-3
    angle = np.arctan2(*(after[:3, :3] @ before[:3, :3].T)[[1, 0], [0, 0]])
    assert abs(angle - 0.3) < 5e-3


def test_torques_hold_the_arm_against_nothing_but_move_it_when_they_push():
    rig = Rig()
    start = rig.robot.q
    rig.start(MoveGenerator.NONE, MoveController.EXTERNAL)
    rig.run(lambda state, t: RobotCommand(state.time), 300)
    assert np.abs(rig.robot.q - start).max() < 1e-4  # the robot compensates gravity
    rig.run(lambda state, t: RobotCommand(state.time, torque=(0, 0, 0, 0, 0, 0, min(t, 0.5))), 300)
    assert rig.robot.q[6] - start[6] > 1e-3
    rig.run(lambda state, t: RobotCommand(state.time, torque=(5.0,) + (0.0,) * 6), 10)
    assert rig.robot.errors == {"controller_torque_discontinuity"}


@pytest.mark.slow
def test_the_robot_interpolates_a_slow_stream():
    rig = Rig()
    start, goal = rig.robot.q, rig.robot.q + ARM
    rig.start(MoveGenerator.JOINT_POSITION, interpolate=True, max_velocity=(0.6,) * 7)
    q = rig.run(
        lambda state, t: RobotCommand(state.time, q=tuple(goal)) if round(t * 1000) % 20 == 0 else None, 1500
    )
    assert np.abs(rig.robot.q - goal).max() < 1e-4
    assert np.abs(np.diff(q, axis=0)).max() < 0.65e-3
    rig.run(lambda state, t: RobotCommand(state.time, motion_finished=True), 100)
    assert rig.answers[-1] is MoveStatus.SUCCESS
    assert np.abs(start - goal).max() > 0.2


def _constant(**fields):
    return lambda state, t: RobotCommand(state.time, **fields)


@pytest.mark.parametrize(
    ("generator", "fields", "error"),
    [
        (
            MoveGenerator.JOINT_POSITION,
            {"q": (0.1,) * 7},
            "joint_position_motion_generator_start_pose_invalid",
        ),
        (MoveGenerator.JOINT_VELOCITY, {"dq": (0.5,) * 7}, "joint_motion_generator_velocity_discontinuity"),
        (
            MoveGenerator.JOINT_VELOCITY,
            {"dq": (9.0,) * 7},
            "joint_motion_generator_velocity_limits_violation",
        ),
        (
            MoveGenerator.CARTESIAN_POSITION,
            {"O_T_EE": (0.0,) * 15 + (1.0,)},
            "cartesian_position_motion_generator_invalid_frame_flag",
        ),
        (
            MoveGenerator.CARTESIAN_VELOCITY,
            {"O_dP_EE": (0.5, 0, 0, 0, 0, 0)},
            "cartesian_motion_generator_velocity_discontinuity",
        ),
    ],
)
def test_a_command_outside_the_limits_is_a_reflex(generator, fields, error):
    rig = Rig()
    before = rig.robot.q
    rig.start(generator)
    rig.run(_constant(**fields), 10)
    assert rig.answers[-1] is MoveStatus.REFLEX_ABORTED
    assert rig.state.errors == rig.state.last_errors == (error,)
    rig.idle(100)
    assert np.abs(rig.robot.q - before).max() < 1e-3


@pytest.mark.slow
def test_missing_commands_lower_the_success_rate_and_twenty_in_a_row_end_the_motion():
    rig = Rig()
    hold = tuple(rig.robot.q)
    rig.start(MoveGenerator.JOINT_POSITION)
    rig.run(lambda state, t: RobotCommand(state.time, q=hold) if round(t * 1000) % 4 else None, 400)
    assert 0.7 < rig.state.success_rate < 0.8
    rig.run(lambda state, t: RobotCommand(state.time - 1, q=hold), 19)  # late: it answers an old state
    assert rig.robot.mode is RobotMode.MOVE
    rig.run(lambda state, t: None, 1)
    assert rig.robot.errors == {"communication_constraints_violation"}
    assert rig.state.success_rate == 0.0


@pytest.mark.slow
def test_a_push_is_felt_and_a_strong_push_is_a_reflex():
    rig = Rig()
    hold = tuple(rig.robot.q)
    rig.start(MoveGenerator.JOINT_POSITION)
    rig.plant.push[:] = 0.0, 8.0, 0.0
    rig.run(lambda state, t: RobotCommand(state.time, q=hold), 500)
    assert abs(rig.state["O_F_ext_hat_K"][1] + 8.0) < 0.5  # forces on the environment are positive
    rig.plant.push[:] = 0.0, 0.0, -80.0
    rig.run(lambda state, t: RobotCommand(state.time, q=hold), 500)
    assert rig.robot.errors == {"cartesian_reflex"}
    rig.plant.push[:] = 0.0
    statuses = []
    rig.idle(100)
    rig.robot.recover(statuses.append)
    assert rig.robot.mode is RobotMode.AUTOMATIC_ERROR_RECOVERY and not statuses
    rig.idle(300)
    assert statuses == [RecoveryStatus.SUCCESS] and rig.robot.mode is RobotMode.IDLE


@pytest.mark.slow
def test_the_configured_load_carries_an_unknown_payload():
    rig = Rig()
    rig.plant.attach_payload(1.0)
    rig.idle(1000)
    sagged = rig.state["tau_ext_hat_filtered"]
    assert np.abs(sagged).max() > 3.0
    center = rig.plant.world.robot.links["panda_link7"].inertial
    assert center is not None
    at = center.T_link_com.translation - (0.0, 0.0, 0.107)
    rig.robot.set_load(1.0, at, np.zeros(9))
    rig.idle(1000)
    assert np.abs(rig.state["tau_ext_hat_filtered"]).max() < 0.2
    assert np.abs(rig.robot.q - rig.robot.reference.q).max() < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["user stop", "reflex", "stop"])
def test_a_moving_arm_comes_to_rest_without_a_step(fault):
    from armcell.emulators.franka.motion_generators import Reflex

    rig = Rig()
    start = rig.robot.q
    rig.start(MoveGenerator.JOINT_POSITION)
    rig.run(lambda state, t: RobotCommand(state.time, q=tuple(start + ARM * swing(t, 1.0)[0])), 500)
    if fault == "user stop":
        rig.robot.user_stop(True)
    elif fault == "reflex":
        rig.robot.abort(Reflex("joint_reflex"))
    else:
        rig.robot.stop()
    before, steps = rig.robot.q, []
    for _ in range(300):
        rig.robot.step([])
        steps.append(np.abs(rig.robot.q - before).max())
        before = rig.robot.q
    assert max(steps) < 2e-3
    assert np.abs(rig.robot.dq).max() < 1e-3
    assert len(rig.answers) == 2
    if fault == "user stop":
        statuses = []
        rig.robot.recover(statuses.append)
        assert statuses == [RecoveryStatus.NOT_POSSIBLE]
        rig.start(MoveGenerator.JOINT_POSITION)
        assert rig.answers == [MoveStatus.NOT_POSSIBLE]
        rig.robot.user_stop(False)
        assert rig.robot.mode is RobotMode.IDLE
