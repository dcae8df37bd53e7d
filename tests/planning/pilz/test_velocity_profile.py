"""The trapezoid, against the figures of MoveIt's unittest_velocity_profile_atrap and unittest_..._ptp."""

from __future__ import annotations

import numpy as np
import pytest

from armcell.planning.pilz.generators import synchronized_profile
from armcell.planning.pilz.velocity_profile import Profile, Trapezoid


def test_moveit_s_scaling_example():
    """testScalingFactor: limits 2, 1.5 and 3, scaled by 0.5 and 1/3; joints go by 1.5, 2.0 and 3.0.

    MoveIt expects 4.5 s: accelerating until 2 s, braking from 3.5 s.
    """
    steps = np.array([1.5, 0.0, 2.0, 0.0, 0.0, 3.0])
    one = np.ones(6)
    z = synchronized_profile(steps, 1.0 * one, 0.5 * one, 1.0 * one)
    assert z.duration == pytest.approx(4.5)
    assert (z.up, z.flat, z.down) == pytest.approx((2.0, 1.5, 1.0))
    _, place, speed = z.at([1.0, 2.0, 3.0, 4.0, 4.5])
    expected = np.array(  # positions and velocities of joint 6, which leads
        [(0.25, 0.5), (1.0, 1.0), (2.0, 1.0), (3.0 - 0.125, 0.5), (3.0, 0.0)]
    )
    np.testing.assert_allclose(3.0 * place, expected[:, 0], atol=1e-12)
    np.testing.assert_allclose(3.0 * speed, expected[:, 1], atol=1e-12)
    np.testing.assert_allclose(1.5 * place[0], 0.125)  # joint 1 and joint 3 at 1 s
    np.testing.assert_allclose(2.0 * place[0], 1.0 / 6.0)
    np.testing.assert_allclose(2.0 * speed[0], 1.0 / 3.0)


def test_too_short_for_full_speed():
    """MoveIt's ATrap: without a middle phase the top speed is sqrt(2 d a b / (a + b))."""
    z = Trapezoid.fastest(0.5, 10.0, 2.0, 3.0)
    assert z.flat == pytest.approx(0.0, abs=1e-12)
    assert z.speed == pytest.approx(np.sqrt(2 * 0.5 * 2 * 3 / 5))
    assert z.distance == pytest.approx(0.5)


@pytest.mark.parametrize("distance", [1e-6, 0.01, 0.7, 40.0])
def test_it_is_at_rest_at_both_ends_and_within_its_limits(distance):
    v, a, d = 1.3, 2.0, 4.5
    profile = Profile(Trapezoid.fastest(distance, v, a, d), 0.032)
    t = np.linspace(0.0, profile.duration, 4001)
    place, speed, acceleration = profile.at(t)
    assert place[0] == pytest.approx(0.0, abs=1e-12) and place[-1] == pytest.approx(distance)
    assert abs(speed[0]) < 1e-12 and abs(speed[-1]) < 1e-9
    assert speed.min() > -1e-9 and speed.max() <= v * (1 + 1e-9)
    assert acceleration.max() <= a * (1 + 1e-6) and acceleration.min() >= -d * (1 + 1e-6)
    # speed and acceleration are the derivatives of the place: trapezoidal sums as the reference
    np.testing.assert_allclose(
        np.cumsum((speed[1:] + speed[:-1]) / 2) * t[1], place[1:], atol=2e-3 * distance
    )


def test_trajectory_points_are_close_and_in_order():
    profile = Profile(Trapezoid.fastest(1.0, 1.0, 2.0, 5.0), 0.032)
    times = profile.times()
    assert times[0] == 0.0 and times[-1] == pytest.approx(profile.duration)
    assert np.all(np.diff(times) > 0) and np.diff(times).max() <= 0.008 + 1e-12
