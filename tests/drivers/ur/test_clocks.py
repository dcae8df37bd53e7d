"""The robot's clock as seen from here: packets come late, never early."""

import numpy as np
import pytest

from armcell.drivers.ur.rtde_client import RobotClock

OFFSET = 1234.5  # [s]


def seen(clock: RobotClock, stamps, late) -> None:
    for stamp, more in zip(stamps, late, strict=True):
        clock.update(float(stamp), float(stamp) + OFFSET + float(more))


def test_the_least_late_packets_tell_the_offset():
    rng, clock = np.random.default_rng(0), RobotClock(125)
    stamps = np.arange(0, 4, 0.008)
    seen(clock, stamps, 2e-4 + rng.exponential(2e-3, len(stamps)))
    assert clock.offset == pytest.approx(OFFSET + 2e-4, abs=2e-4)  # a mean would be 2 ms off


def test_a_delay_that_begins_is_lateness_at_first_and_not_the_robot_s_time():
    clock = RobotClock(125)
    seen(clock, np.arange(0, 2, 0.008), np.zeros(250))
    seen(clock, np.arange(2, 2.8, 0.008), np.full(100, 0.2))
    assert clock.offset == pytest.approx(OFFSET, abs=1e-9)  # so that the state counts as 0.2 s old


def test_a_robot_s_clock_that_drifts_is_followed_without_jumps():
    clock, offsets = RobotClock(125), []
    stamps = np.arange(0, 20, 0.008)
    for stamp in stamps:
        clock.update(float(stamp), float(stamp) + OFFSET + 1e-3 * float(stamp))
        offsets.append(clock.offset)
    assert np.abs(np.diff(offsets)).max() < 1e-3
    assert offsets[-1] == pytest.approx(OFFSET + 1e-3 * 20, abs=1.1e-3)  # the window is a second long
