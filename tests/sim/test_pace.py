"""The pacer, on a clock of our own."""

from __future__ import annotations

import pytest

from armcell.core import InputError
from armcell.sim import Pacer


class Clock:
    def __init__(self):
        self.now = 100.0

    def __call__(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


def test_lock_step_never_waits():
    clock = Clock()
    assert Pacer(None, clock, clock.sleep).wait_until(1e6) == 0.0 and clock.now == 100.0


@pytest.mark.parametrize("scale", (0.5, 1.0, 4.0))
def test_wall_clock_times_scale(scale):
    clock = Clock()
    pacer = Pacer(scale, clock, clock.sleep)
    for i in range(11):
        pacer.wait_until(7.0 + 0.1 * i)
    assert clock.now - 100.0 == pytest.approx(1.0 / scale)


def test_a_slow_simulation_is_not_rushed():
    clock = Clock()
    pacer = Pacer(1.0, clock, clock.sleep)
    pacer.wait_until(0.0)
    clock.now += 5.0
    assert pacer.wait_until(0.1) == 0.0
    assert pacer.wait_until(0.3) == pytest.approx(0.1)  # 0.1 s of the lag is made up for, the rest forgotten
    pacer.reset()
    assert pacer.wait_until(9.0) == 0.0


def test_bad_scale():
    with pytest.raises(InputError):
        Pacer(0.0)
