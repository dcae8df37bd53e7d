"""Targets worked out ahead are those of the very times at which they are used."""

from __future__ import annotations

import numpy as np

from armcell.sim import JointTargets
from armcell.sim.servo import AHEAD

STEP = 0.002


class Wanted:
    """Positions are the time, velocities its negative; `asked` counts."""

    def __init__(self):
        self.asked = 0

    def __call__(self, times):
        self.asked += 1
        return times[:, None], -times[:, None]


def test_rows_are_those_of_the_times_as_steps_add_them_up():
    wanted, now, steps = Wanted(), 0.3, 2
    targets = JointTargets(wanted, STEP, steps)
    while now < 0.3 + 2.5 * AHEAD:
        times, until = [], now + 0.02
        while not times or now < until:
            times.append(now)
            for _ in range(steps):
                now += STEP
        rows = targets.between(times[0], until)
        assert rows[:, 0].tolist() == times and rows[:, 1].tolist() == [-t for t in times]
    assert wanted.asked == 3


def test_at_least_one_however_short():
    targets = JointTargets(Wanted(), STEP, 2)
    for until in (-1.0, 0.0, 1e-4):
        assert targets.between(0.0, until)[:, 0].tolist() == [0.0]


def test_a_time_that_is_not_foreseen_is_worked_out_anew():
    wanted = Wanted()
    targets = JointTargets(wanted, STEP, 2)
    targets.between(0.0, 0.02)
    for now in (0.101, 5.0, 0.0505):  # between two ticks, later, back again
        rows = targets.between(now, now + 0.02)
        assert rows[0, 0] == now and np.allclose(np.diff(rows[:, 0]), 2 * STEP)
    assert wanted.asked == 4
    assert len(targets.between(0.0, 3 * AHEAD - STEP)) == round(3 * AHEAD / (2 * STEP))
