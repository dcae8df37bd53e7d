"""Torque limits: kept by pinocchio's rnea along the result, and as fast as toppra's torque constraint."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pinocchio as pin
import pytest
from tests.model.helpers import pin_library
from tests.timing.helpers import sampled, toppra_duration

from armcell.core import SE3, InputError
from armcell.kinematics import InverseDynamics
from armcell.model import Inertial, load_robot
from armcell.timing import BlendedPath, TimingSettings, TorqueLimitError, parameterize

PAYLOAD = 8.0  # [kg]
WINDOW = TimingSettings().smoothing


@lru_cache
def robot(payload: float = PAYLOAD):
    model = load_robot("ur10")
    names = model.group("arm").joint_names
    body = Inertial(payload, SE3.from_xyz(0.02, 0.0, 0.1), np.eye(3) * 0.05)
    return model, names, InverseDynamics(model, names, payloads=[(model.group("arm").tip_link, body)])


@lru_cache
def rnea(payload: float = PAYLOAD):
    """The same arm and payload as pinocchio sees them."""
    model, data = pin_library("ur10"), None
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    frame = model.frames[model.getFrameId(robot()[0].group("arm").tip_link, pin.FrameType.BODY)]
    body = pin.Inertia(payload, np.array([0.02, 0.0, 0.1]), np.eye(3) * 0.05)
    model.inertias[frame.parentJoint] += frame.placement.act(body)
    data = model.createData()
    assert list(model.names)[1:] == list(robot()[1])
    return lambda q, v, a: pin.rnea(model, data, np.asarray(q), np.asarray(v), np.asarray(a)).copy()


@lru_cache
def timed(seed: int):
    """A path, and its motion with accelerations too fast for the motors, with and without torque limits."""
    model, names, dynamics = robot()
    rng = np.random.default_rng(seed)
    walk = np.vstack([model.default_positions()[model.columns(names)], rng.normal(0, 0.3, (7, 6))])
    path = BlendedPath(np.cumsum(walk, axis=0), 0.05)
    v, a = model.limits(names, "velocity"), 4 * model.limits(names, "acceleration")
    return path, v, a, parameterize(path, names, v, a), parameterize(path, names, v, a, torque=dynamics)


@pytest.mark.slow
@pytest.mark.cases("0", "1")
@pytest.mark.parametrize("seed", range(5))
def test_pinocchio_finds_every_torque_within_its_limit(seed):
    _, v, a, without, trajectory = timed(seed)
    limits = robot()[2].limits
    share = lambda t: max(np.max(np.abs(rnea()(*s)) / limits) for s in zip(*sampled(t), strict=True))  # noqa: E731
    assert share(without) > 1.05  # without torque limits they are broken
    assert 0.9 < share(trajectory) <= 1.0
    _, speed, acceleration = sampled(trajectory)
    assert np.max(np.abs(speed) / v) <= 1.0 + 1e-9 and np.max(np.abs(acceleration) / a) <= 1.0 + 1e-9


@pytest.mark.parametrize("seed", range(5))
def test_as_fast_as_toppra_with_pinocchio_s_torques(seed):
    path, v, a, without, trajectory = timed(seed)
    best = toppra_duration(path, v, a, 600, rnea(), robot()[2].limits)
    assert 0.995 * best <= trajectory.duration - WINDOW <= 1.03 * best
    assert trajectory.duration > without.duration


def test_weak_limits_slow_and_strong_ones_change_nothing():
    model, names, _ = robot()
    path, v, a, without, _ = timed(0)

    class Strong(InverseDynamics):
        limits = property(lambda self: np.full(6, 1e4))

    strong = parameterize(path, names, v, a, torque=Strong(model, names))
    assert strong.duration == pytest.approx(without.duration, rel=0.01)


def test_too_heavy_to_hold_names_joint_torque_and_limit():
    _, names, dynamics = robot(60.0)
    path, v, a, _, _ = timed(0)
    with pytest.raises(TorqueLimitError, match=r"joint '\w+' takes [\d.]+ Nm") as caught:
        parameterize(path, names, v, a, torque=dynamics)
    error = caught.value
    points = path.at(np.linspace(0, path.length, 2000))[0]
    still = np.array([rnea(60.0)(q, np.zeros(6), np.zeros(6)) for q in points])
    assert error.joint == names[int(np.argmax((np.abs(still) / dynamics.limits).max(axis=0)))]
    assert error.torque == pytest.approx(np.abs(still[:, names.index(error.joint)]).max(), rel=1e-3)
    assert error.limit == dynamics.limits[names.index(error.joint)] and 0.0 <= error.place <= 1.0


@pytest.mark.parametrize("bad", [0.0, np.nan, np.inf])
def test_a_missing_effort_limit_names_the_joint(bad):
    model, names, _ = robot()
    path, v, a, _, _ = timed(0)

    class Broken(InverseDynamics):
        limits = property(lambda self: np.where(np.arange(6) == 3, bad, 100.0))

    with pytest.raises(InputError, match="joint 'wrist_1_joint' has no effort limit"):
        parameterize(path, names, v, a, torque=Broken(model, names))
