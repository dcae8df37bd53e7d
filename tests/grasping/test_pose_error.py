"""Grasps that allow for an error of the object's believed pose."""

from __future__ import annotations

import numpy as np
import pytest
from tests.grasping.solids import solid

from armcell.core import SE3, Box
from armcell.grasping import approach_depth, grasp_candidates, hand_of, openings, pre_opening
from armcell.grasping.hand_fit_kernel import GAP, MARGIN
from armcell.model import load_robot

CUBE = solid(Box(0.05, 0.05, 0.05), SE3.from_xyz(0.5, 0.1, 0.3))


@pytest.fixture(scope="module", params=["panda", "ur10_gripper"])
def hand(request):
    model = load_robot(request.param)
    return hand_of(model, model.gripper())


@pytest.mark.parametrize("error", [0.0, 0.003, 0.005, 0.01])
def test_each_finger_passes_an_object_beside_its_believed_pose(hand, error):
    grasps, _ = grasp_candidates(CUBE, hand, pose_error=error)
    assert grasps
    for grasp in grasps:
        beside = (grasp.opening - grasp.width) / 2
        most = (hand.gripper.max_width - grasp.width) / 2
        assert beside >= min(max(error + GAP, MARGIN / 2), most) - 1e-9


def test_a_grasp_beside_an_obstacle_may_open_less(hand):
    (grasp, *_), _ = grasp_candidates(CUBE, hand, pose_error=0.01)
    wide, narrow = openings(grasp, hand.gripper)
    assert wide is grasp
    assert narrow.opening == pytest.approx(pre_opening(grasp.width, hand.gripper))
    assert narrow.opening < grasp.opening
    # the pads close at the same point of the object
    for one in (wide, narrow):
        center = one.T_object_tcp @ hand.gripper.grip_center(one.width, one.opening)
        np.testing.assert_allclose(
            center.translation,
            (wide.T_object_tcp @ hand.gripper.grip_center(wide.width, wide.opening)).translation, atol=1e-9,
        )  # fmt: skip
    (grasp, *_), _ = grasp_candidates(CUBE, hand, pose_error=0.0)
    assert list(openings(grasp, hand.gripper)) == [grasp]


def test_grasps_that_tolerate_an_error_come_first(hand):
    """Only across its narrow side, a block leaves the fingers space for an error."""
    wide = hand.gripper.max_width - 0.006
    plate = solid(Box(0.04, wide, 0.05), SE3.from_xyz(0.5, 0.1, 0.3))
    grasps, _ = grasp_candidates(plate, hand, pose_error=0.005)
    widths = [grasp.width for grasp in grasps]
    assert widths[0] < 0.05 and max(widths) > 0.06


def test_the_open_hand_enters_an_object_that_is_farther_off_than_its_opening_allows(hand):
    (grasp, *_), _ = grasp_candidates(CUBE, hand, pose_error=0.005)
    beside = (grasp.opening - grasp.width) / 2
    for share, enters in ((0.0, False), (0.9, False), (1.5, True), (-1.5, True)):
        moved = grasp.T_object_tcp @ SE3.from_xyz(0.0, share * beside, 0.0)
        assert (approach_depth(CUBE, hand, grasp, moved) > 0.0) == enters


def test_the_palm_may_touch_the_object_at_the_end_of_the_approach(hand):
    (grasp, *_), _ = grasp_candidates(CUBE, hand, pose_error=0.0)
    deeper = grasp.T_object_tcp @ SE3.from_xyz(0.0, 0.0, 0.05)
    assert approach_depth(CUBE, hand, grasp, deeper) == 0.0
