"""Setpoints of a Franka arm: accepted by the emulated robot's checks, also when packets are lost."""

from __future__ import annotations

import numpy as np
import pytest
from tests.emulators.franka.rig import Rig
from tests.sizes import seeds

from armcell.core import JointTrajectory
from armcell.core.errors import InputError
from armcell.drivers.franka.arm import time_stretch
from armcell.drivers.franka.setpoint_stream import (
    COAST,
    TICK,
    SampledTrajectory,
    SetpointStream,
    TimedSetpoints,
)
from armcell.drivers.franka.settings import FR3, PANDA
from armcell.drivers.franka.wire.commands import MoveGenerator, MoveStatus
from armcell.drivers.franka.wire.state import RobotCommand, RobotMode

SPEED, ACCELERATION = 1.2, 7.0


def trapezoid(q: np.ndarray, amplitude: np.ndarray) -> np.ndarray:
    """Rows (n, 7) of a motion with steps of acceleration, as time-optimal motions have."""
    rise = SPEED / ACCELERATION
    flat = 1.0 / SPEED - rise
    t = np.arange(0.0, 2 * rise + flat + TICK, TICK)
    v = np.clip(np.minimum(t, 2 * rise + flat - t) * ACCELERATION, 0.0, SPEED)
    s = np.cumsum(v) * TICK
    return q + np.minimum(s, s[-1])[:, None] * amplitude


def drive(
    rig: Rig, setpoints: SetpointStream, lost, milliseconds: int, pace=lambda t: 1.0, wall=lambda k: k * TICK
) -> np.ndarray:
    """Answer the robot's states with setpoints; `lost(k)`: 1 if a state, 2 if a command is lost.

    `wall(k)` is the wall time [s] at which state k arrives.
    """
    rig.start(MoveGenerator.JOINT_POSITION)
    last, path = rig.state.time - 1, []
    for k in range(milliseconds):
        state, command = rig.state, None
        if lost(k) != 1:
            ticks, last = state.time - last, state.time
            q = setpoints.next(ticks, pace(k * TICK), wall(k), *(state[x] for x in ("q_d", "dq_d", "ddq_d")))
            command = RobotCommand(state.time, q=tuple(q), motion_finished=setpoints.finished)
        rig.robot.step([command] if command is not None and lost(k) != 2 else [])
        path.append(rig.robot.reference.q)
        if rig.robot.mode is not RobotMode.MOVE:
            break
    return np.array(path)


@pytest.mark.slow
@pytest.mark.cases("0")
@pytest.mark.parametrize("seed", seeds(2, range(4)))
def test_lost_states_and_commands_never_make_the_arm_jump(seed):
    rig, rng = Rig(), np.random.default_rng(seed)
    amplitude = rng.uniform(-0.4, 0.4, 7)
    rows = trapezoid(rig.robot.reference.q, amplitude)
    gaps = np.zeros(3000, dtype=int)
    for start in rng.integers(20, 1000, 6):
        gaps[start : start + rng.integers(1, 15)] = rng.integers(1, 3)
    path = drive(rig, SetpointStream(SampledTrajectory(rows)), lambda k: gaps[k], 3000)
    assert rig.answers == [MoveStatus.STARTED, MoveStatus.SUCCESS], rig.texts
    assert np.abs(path[-1] - rows[-1]).max() < 1e-5
    assert np.abs(np.diff(path, axis=0)).max() < 1.5 * SPEED * TICK


def test_a_deviation_of_micrometers_is_no_step():
    """A robot may extrapolate lost commands to within 3e-6 rad: such a step is 6000 rad/s^3 at 1 kHz."""
    setpoints, rest = SetpointStream(SampledTrajectory(np.zeros((100, 7)))), np.zeros(7)
    setpoints.next(1, 1.0, 0.0, rest, rest, rest)
    here = np.full(7, 2.8e-6)
    step = setpoints.next(1, 1.0, TICK, here, rest, rest) - here
    assert 2.0 * np.abs(step).max() / TICK**3 < 0.1 * FR3.jerk.min()


@pytest.mark.parametrize("model", [FR3, PANDA], ids=["fr3", "panda"])
def test_rounding_never_carries_a_motion_at_a_joint_limit_beyond_it(model):
    rise = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, 400))[:, None]
    for limit, start in ((model.upper, model.upper - 0.2), (model.lower, model.lower + 0.2)):
        rows = start + rise * (limit - start)
        rows[-1] = limit
        setpoints = SetpointStream(SampledTrajectory(rows), limits=(model.lower, model.upper))
        q, rest = start, np.zeros(7)
        while not setpoints.finished:
            q = setpoints.next(1, 1.0, 0.0, q, rest, rest)
            assert (q > model.lower).all() and (q < model.upper).all()
        assert np.abs(q - limit).max() < 2e-9


@pytest.mark.slow
def test_a_motion_may_start_beside_the_setpoint_and_follow_the_slider():
    rig = Rig()
    rows = trapezoid(rig.robot.reference.q + 0.003, np.full(7, 0.3))
    slider = lambda t: 0.0 if 0.3 < t < 0.8 else 0.6  # noqa: E731
    path = drive(rig, SetpointStream(SampledTrajectory(rows), pace=0.6), lambda k: 0, 4000, slider)
    assert rig.answers[-1] is MoveStatus.SUCCESS, rig.texts
    assert np.abs(path[-1] - rows[-1]).max() < 1e-5
    assert len(path) > len(rows) / 0.6 + 400


@pytest.mark.slow
def test_streamed_points_are_joined_and_end_at_rest():
    rig = Rig()
    start, points = rig.robot.reference.q, TimedSetpoints()
    for k in range(60):
        t = 0.008 * k
        s, v = 0.1 * (1 - np.cos(2 * t)), 0.2 * np.sin(2 * t)
        points.add(t + 0.04, start + s, np.full(7, v))
    path = drive(rig, SetpointStream(points), lambda k: 0, 3000)
    assert rig.answers[-1] is MoveStatus.SUCCESS, rig.texts
    coasted = (0.2 * np.sin(2 * 0.472)) ** 2 / (2 * COAST)
    assert np.abs(path[-1] - start - 0.1 * (1 - np.cos(2 * 0.472)) - coasted).max() < 1e-5


@pytest.mark.slow
@pytest.mark.cases("0")
@pytest.mark.parametrize("seed", seeds(2, range(6)))
def test_streamed_points_with_jitter_delays_and_a_gap_never_make_the_arm_jump(seed):
    rig, rng = Rig(), np.random.default_rng(seed)
    start, points = rig.robot.reference.q, TimedSetpoints()
    amplitude = rng.uniform(-0.3, 0.3, 7)
    late = np.cumsum(rng.exponential(0.05 * TICK, 5000))  # the robot's clock is 5 % slow, and states are late
    late[int(rng.integers(200, 900)) :] += rng.uniform(0.02, 0.2)
    gap = int(rng.integers(40, 120))  # the program pauses for 0.15 s, until the arm has passed the last point

    def wall(k: int) -> float:
        now = k * TICK + late[k]
        while wall.sent < 200 and now >= (due := wall.sent * 0.008 + 0.15 * (wall.sent > gap)):
            x = wall.sent * 0.008
            s, v = 0.5 * (1 - np.cos(2 * x)), np.sin(2 * x)
            points.add(due + 0.04, start + s * amplitude, v * amplitude)
            wall.sent += 1
        return now + rng.exponential(0.4 * TICK)

    wall.sent = 0
    wall(0)
    path = drive(rig, SetpointStream(points), lambda k: 0, 5000, wall=wall)
    assert wall.sent == 200 and rig.answers[-1] is MoveStatus.SUCCESS, rig.texts
    v = np.abs(np.sin(2 * 1.592) * amplitude)
    goal = start + 0.5 * (1 - np.cos(2 * 1.592)) * amplitude
    assert np.abs(path[-1] - goal - np.sign(np.sin(2 * 1.592) * amplitude) * v**2 / (2 * COAST)).max() < 1e-5


def _trajectory(goal: float, duration: float, joint: int = 0) -> JointTrajectory:
    names = tuple(f"j{i}" for i in range(7))
    start = np.array([0.0, -0.78, 0.0, -2.35, 0.0, 1.57, 0.78])
    t = np.linspace(0.0, duration, 101)
    x = t / duration
    s, v = 3 * x**2 - 2 * x**3, 6 * (x - x**2) / duration
    move = np.eye(7)[joint] * goal
    return JointTrajectory(names, t, start + s[:, None] * move, v[:, None] * move)


def test_a_fast_motion_is_slowed_to_the_limits_and_a_slow_one_is_not():
    assert time_stretch(_trajectory(0.5, 3.0), FR3) == 1.0
    slower = time_stretch(_trajectory(1.5, 0.6), FR3)
    assert 1.4 < slower < 4.0
    assert time_stretch(_trajectory(1.5, 0.6 * slower), FR3) == pytest.approx(1.0, abs=0.05)


def test_a_motion_beyond_a_joint_limit_is_rejected():
    with pytest.raises(InputError, match=r"takes joint 4 to -3.07.* fr3's limits are -3.0421"):
        time_stretch(_trajectory(-0.72, 3.0, joint=3), FR3)
    assert time_stretch(_trajectory(-0.70, 3.0, joint=3), PANDA) >= 1.0
