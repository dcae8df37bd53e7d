"""Motions that keep apart whenever each is made: the proof against coal at random times of both."""

from __future__ import annotations

import numpy as np
import pytest
from tests.planning.multi_arm.dual import LEFT, RIGHT, Judge, motion, scene, tip

from armcell.collision.inter_arm_checker import InterArmChecker
from armcell.core import JointTrajectory
from armcell.planning import RunningMotion
from armcell.timing import reverse_trajectory

pytestmark = pytest.mark.slow

CLEARANCE = 0.02


@pytest.fixture(scope="module")
def arms():
    return InterArmChecker(scene(), (LEFT, RIGHT))


def standing(motion: JointTrajectory, t: float) -> RunningMotion:
    q = motion.sample(t)[0][None]
    return RunningMotion(JointTrajectory(motion.joint_names, np.zeros(1), q, q * 0, q * 0))


def test_what_is_proven_keeps_its_distance_at_all_pairs_of_times(arms):
    rng, judge, proven = np.random.default_rng(2), Judge(scene()), 0
    for _ in range(14):
        left = motion(scene(), LEFT, tip(rng.uniform(-0.5, 0.5), rng.uniform(0.0, 0.25)))
        right = motion(scene(), RIGHT, tip(rng.uniform(-0.5, 0.5), rng.uniform(-0.25, 0.0)))
        if not arms.certify_any_time(left, right, CLEARANCE):
            continue
        proven += 1
        for _ in range(60):
            stands = [standing(m, rng.uniform(0, m.duration)) for m in (left, right)]
            assert judge.nearest(*stands) >= CLEARANCE - 1e-6
    assert proven >= 3


def test_a_pair_that_only_its_times_keep_apart_is_refused(arms):
    left, right = motion(scene(), LEFT, tip(0.0, -0.1)), motion(scene(), RIGHT, tip(0.0, 0.1))
    back = reverse_trajectory(left)
    start = left.duration + 0.5  # the right arm goes in when the left one has gone out again
    assert arms.certify(back, right, starts=(0.0, start), clearance=CLEARANCE).free
    assert not arms.certify_any_time(back, right, CLEARANCE)
    apart = motion(scene(), LEFT, tip(-0.5, 0.2)), motion(scene(), RIGHT, tip(0.5, -0.2))
    assert arms.certify(*apart, clearance=CLEARANCE).free
    assert arms.certify_any_time(*apart, CLEARANCE)
