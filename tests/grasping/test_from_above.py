"""Grasps on a map of heights: checked by geometry of things whose size is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import minimum_filter

from armcell.core import HeightMap, InputError
from armcell.grasping import TopDownGraspSettings, hand_of, top_down_grasps
from armcell.model import load_robot

CELL = 0.003
MODEL = load_robot("ur10_gripper")
HAND = hand_of(MODEL, MODEL.gripper())
TIPS = 0.012  # [m] the fingers end beyond the tcp (parallel_gripper.urdf)
FINGER = (0.011, 0.012)  # [m] half width and thickness of a finger, there as well


def with_boxes(*boxes, size=(0.5, 0.5)):
    """A map with boxes (x, y, length, width, yaw, height), and the number of the box in each cell."""
    n = [round(s / CELL) + 1 for s in size]
    x, y = np.meshgrid(CELL * np.arange(n[0]), CELL * np.arange(n[1]), indexing="ij")
    heights, labels = np.zeros(n), np.full(n, -1)
    for k, (cx, cy, length, width, yaw, height) in enumerate(boxes):
        u = np.cos(yaw) * (x - cx) + np.sin(yaw) * (y - cy)
        v = -np.sin(yaw) * (x - cx) + np.cos(yaw) * (y - cy)
        inside = (np.abs(u) <= length / 2) & (np.abs(v) <= width / 2)
        heights[inside], labels[inside] = height, k
    return HeightMap(heights, np.ones(n, bool), (0.0, 0.0), CELL), labels


def closing(grasp):
    return grasp.T_object_tcp.rotation.matrix[:, 1]


def under_fingers(seen, grasp):
    """The highest cell under either open finger (independent of the kernel: cells in rotated rectangles)."""
    index = np.argwhere(np.isfinite(seen.heights))
    local = grasp.T_object_tcp.inverse().apply(seen.at(index))
    beyond = np.abs(local[:, 1]) - grasp.opening / 2
    inside = (np.abs(local[:, 0]) <= FINGER[0]) & (beyond >= 0) & (beyond <= FINGER[1])
    return seen.at(index)[inside, 2].max()


@pytest.mark.slow
@pytest.mark.parametrize("yaw_deg", [0, 22.5, 45, 90, 135])
def test_a_box_is_held_across_its_narrow_side(yaw_deg):
    yaw = np.deg2rad(yaw_deg)
    seen, labels = with_boxes((0.25, 0.25, 0.12, 0.04, yaw, 0.05))
    best = top_down_grasps(seen, labels, 0.0, HAND, 20.0)[0]
    across = np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    assert abs(closing(best) @ across) > 0.98
    assert best.width == pytest.approx(0.04, abs=2.5 * CELL)
    np.testing.assert_allclose(best.T_object_tcp.translation[:2], 0.25, atol=0.01)
    np.testing.assert_allclose(best.T_object_tcp.rotation.matrix[:, 2], (0, 0, -1), atol=1e-9)


@pytest.mark.slow
def test_no_open_finger_goes_into_anything():
    rng = np.random.default_rng(4)
    boxes = [
        (
            *rng.uniform(0.08, 0.42, 2),
            *rng.uniform(0.02, 0.1, 2),
            rng.uniform(0, np.pi),
            rng.uniform(0.02, 0.1),
        )
        for _ in range(12)
    ]
    seen, labels = with_boxes(*boxes)
    found = top_down_grasps(seen, labels, 0.0, HAND, 20.0)
    assert len(found) > 20
    for grasp in found:
        tips = grasp.T_object_tcp.translation[2] - TIPS
        assert tips == pytest.approx(grasp.tip, abs=1e-9) and tips >= 0.003 - 1e-9
        assert under_fingers(seen, grasp) < tips
        assert grasp.width < grasp.opening <= HAND.gripper.max_width


def test_beside_a_wall_it_is_held_along_the_wall():
    seen, labels = with_boxes((0.25, 0.25, 0.05, 0.05, 0.0, 0.05), (0.25, 0.2785, 0.4, 0.008, 0.0, 0.06))
    labels[labels == 1] = -1
    found = top_down_grasps(seen, labels, 0.0, HAND, 20.0)
    assert found and all(abs(closing(g)[0]) > 0.9 for g in found)


@pytest.mark.parametrize(
    "box", [(0.25, 0.25, 0.12, 0.11, 0.0, 0.05), (0.25, 0.25, 0.05, 0.05, 0.0, 0.004)], ids=["wide", "flat"]
)
def test_what_does_not_fit_gives_nothing(box):
    seen, labels = with_boxes(box)
    assert top_down_grasps(seen, labels, 0.0, HAND, 20.0) == []


@pytest.mark.slow
@pytest.mark.cases("0", "45")
@pytest.mark.parametrize("yaw_deg", range(0, 90, 5))
def test_a_plate_wider_than_the_hand_is_not_held_by_its_corners_either(yaw_deg):
    seen, labels = with_boxes((0.25, 0.25, 0.16, 0.15, np.deg2rad(yaw_deg), 0.03))
    for settings in (TopDownGraspSettings(), TopDownGraspSettings(room=0.0045, turns=32, least_touch=0.15)):
        assert top_down_grasps(seen, labels, 0.0, HAND, 20.0, settings) == []


def test_the_upper_of_two_comes_first():
    seen, labels = with_boxes((0.15, 0.25, 0.05, 0.04, 0.0, 0.04), (0.35, 0.25, 0.05, 0.04, 0.0, 0.10))
    assert top_down_grasps(seen, labels, 0.0, HAND, 20.0)[0].piece == 1


def test_another_piece_is_tried_after_a_failure():
    seen, labels = with_boxes((0.15, 0.25, 0.05, 0.04, 0.0, 0.05), (0.35, 0.25, 0.05, 0.04, 0.0, 0.05))
    first = top_down_grasps(seen, labels, 0.0, HAND, 20.0)[0]
    second = top_down_grasps(seen, labels, 0.0, HAND, 20.0, avoid=[first])[0]
    assert second.piece != first.piece


def test_another_kind_of_grasp_is_tried_after_a_failure():
    """Also if the failed grasp has moved the piece, and the camera measures its width to two cells."""
    seen, labels = with_boxes((0.25, 0.25, 0.08, 0.03, 0.0, 0.05))
    first = top_down_grasps(seen, labels, 0.0, HAND, 20.0)[0]
    moved, labels = with_boxes((0.29, 0.27, 0.08, 0.03, 0.3, 0.05))
    second = top_down_grasps(moved, labels, 0.0, HAND, 20.0, avoid=[first])[0]
    assert abs(second.width - first.width) > 0.007


def test_fingers_do_not_hold_only_the_top_of_a_tall_piece():
    """Beside a wall as high as most of the piece, the fingers have room above the wall only."""
    boxes = (0.25, 0.25, 0.08, 0.06, 0.0, 0.06), (0.25, 0.30, 0.3, 0.04, 0.0, 0.05)
    seen, labels = with_boxes(*boxes)
    firm = top_down_grasps(seen, np.where(labels == 0, 0, -1), 0.0, HAND, 20.0)
    assert all(g.top - g.tip >= 0.2 * g.width for g in firm)
    settings = TopDownGraspSettings(least_grip=0.0)
    assert len(top_down_grasps(seen, np.where(labels == 0, 0, -1), 0.0, HAND, 20.0, settings)) > len(firm)


def beside_tall_walls():
    """A map with a block in a corner between two walls that are taller than the fingers are long."""
    boxes = (0.25, 0.25, 0.04, 0.04, 0.0, 0.05), (0.25, 0.282, 0.4, 0.02, 0.0, 0.15)
    seen, labels = with_boxes(*boxes, (0.195, 0.25, 0.02, 0.4, 0.0, 0.15))
    labels[labels > 0] = -1
    return seen, labels


def parts_of_open_hand(grasp):
    """Points (n, 3) on and in the fingers and the palm of the open hand, in the tcp frame."""
    aside = np.array([0.0, grasp.opening / 2, 0.0] * 2)
    boxes = [*HAND.palm, *(HAND.left + aside), *(HAND.right - aside)]
    steps = np.linspace(0.0, 1.0, 25)
    unit = np.stack(np.meshgrid(steps, steps, steps), -1).reshape(-1, 3)
    return np.vstack([b[:3] + unit * (b[3:] - b[:3]) for b in boxes])


@pytest.mark.parametrize("tilt", [0.52, 0.7])
def test_a_slanted_hand_reaches_between_tall_walls_and_touches_nothing(tilt):
    seen, labels = beside_tall_walls()
    settings = TopDownGraspSettings(room=0.0045, tilt=tilt)
    assert top_down_grasps(seen, labels, 0.0, HAND, 20.0, replace(settings, tilt=0.0)) == []
    found = top_down_grasps(seen, labels, 0.0, HAND, 20.0, settings)
    assert found
    lowest = minimum_filter(seen.heights, size=3)  # a point may be in the next cell
    for grasp in found:
        T = grasp.T_object_tcp
        np.testing.assert_allclose(T.rotation.matrix[2, 2], -np.cos(tilt), atol=1e-9)
        hand = parts_of_open_hand(grasp)
        for back in np.linspace(0.0, 0.1, 21):
            at = T.apply(hand - (0.0, 0.0, back))
            cells = np.round(at[:, :2] / CELL).astype(int).clip(0, np.array(seen.heights.shape) - 1)
            assert (at[:, 2] > lowest[cells[:, 0], cells[:, 1]]).all()
        assert T.apply(hand)[:, 2].min() == pytest.approx(grasp.tip, abs=1e-9)
        middle = T.apply((0.0, 0.0, TIPS))
        assert np.linalg.norm(middle[:2] - 0.25) < 0.03 and 0.0 < middle[2] < 0.05


def test_bad_input_is_said():
    seen, labels = with_boxes((0.25, 0.25, 0.05, 0.04, 0.0, 0.05))
    with pytest.raises(InputError, match="labels"):
        top_down_grasps(seen, labels[1:], 0.0, HAND, 20.0)
    for name, value in {"room": 0.0, "tilt": 1.6, "tilt_directions": 0}.items():
        with pytest.raises(InputError, match=name):
            TopDownGraspSettings(**{name: value})
