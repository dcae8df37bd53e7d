"""explain_pose: every branch it lists is a solution, and what it says touches, touches."""

from __future__ import annotations

import numpy as np
import pytest
from tests.planning.helpers import down, panda_wall
from tests.scene.helpers import box, panda, ur10

from armcell.collision import ExactChecker
from armcell.core import JointState
from armcell.planning import explain_pose


def check_branches(scene, explanation, target):
    names = explanation.joint_names
    checker = ExactChecker(scene, names)
    tip = scene.model.group("arm").tip_link
    for branch in explanation.branches:
        there = scene.with_state(JointState(names, branch.positions))
        assert there.frame_pose(tip).isclose(target, 1e-5, 1e-4)
        assert branch.free == checker.is_free(branch.positions)
    free = [b.free for b in explanation.branches]
    assert free == sorted(free, reverse=True)  # the free ones first


def test_a_free_pose():
    scene, target = panda_wall(), down(0.5, 0.25, 0.2)
    explanation = explain_pose(scene, "arm", target)
    assert explanation.reachable and explanation.branches[0].free and not explanation.start_contacts
    count = sum(b.free for b in explanation.branches)
    assert f"{count} of {len(explanation.branches)} joint solutions are free" == explanation.summary
    check_branches(scene, explanation, target)


def test_a_blocked_pose_says_what_is_in_the_way():
    target = down(0.7, 0.0, 0.3)
    scene = ur10(box("crate", (0.3, 0.3, 0.3), (0.7, 0.0, 0.3)))
    explanation = explain_pose(scene, "arm", target)
    assert (
        not explanation.reachable and explanation.branches and not any(b.free for b in explanation.branches)
    )
    assert "crate" in explanation.summary and " mm deep" in explanation.summary
    check_branches(scene, explanation, target)


def test_out_of_reach_says_how_far():
    explanation = explain_pose(panda(), "arm", down(2.0, 0.0, 0.3))
    assert not explanation.reachable and explanation.branches == []
    # The shoulder is at 0.333 m and no Panda is longer than 1.2 m with its hand.
    assert explanation.position_error > np.hypot(2.0, 0.033) - 1.2
    assert "cannot reach" in explanation.summary


def test_a_start_in_collision_is_told_as_well():
    scene = panda(box("block", (0.1, 0.1, 0.1), (0.307, 0.0, 0.62)))
    explanation = explain_pose(scene, "arm", down(0.3, 0.4, 0.4))
    assert explanation.reachable
    assert "block" in {n for c in explanation.start_contacts for n in (c.body_a, c.body_b)}
    assert "but the start is in collision" in explanation.summary


@pytest.mark.parametrize("seed", [0, 1])
def test_the_same_seed_gives_the_same_branches(seed):
    scene, target = panda_wall(), down(0.5, 0.25, 0.2)
    a, b = (explain_pose(scene, "arm", target, seed=seed) for _ in range(2))
    assert len(a.branches) == len(b.branches)
    for one, other in zip(a.branches, b.branches):
        np.testing.assert_array_equal(one.positions, other.positions)
