"""Pushes that move pieces of a heap away from walls."""

from __future__ import annotations

import numpy as np
import pytest

from armcell.core import HeightMap, InputError
from armcell.grasping import PushSettings, hand_of, pushes_off_walls
from armcell.model import load_robot

MODEL = load_robot("ur10_gripper")
HAND = hand_of(MODEL, MODEL.gripper())
CELL = 0.003
CELLS = 220
AXIS = CELL * np.arange(CELLS)
X, Y = np.meshgrid(AXIS, AXIS, indexing="ij")
WALL = (X < 0.12) | (X > 0.54) | (Y < 0.12) | (Y > 0.54)  # wide: the palm must stay over the map


def bin_with(*boxes, height=0.04):
    """A walled bin with boxes (x, y, size x, size y), its labels and its floor cells."""
    heights, labels = np.where(WALL, 0.05, 0.0), np.full(X.shape, -1)
    for k, (x, y, size_x, size_y) in enumerate(boxes):
        inside = (np.abs(X - x) < size_x / 2) & (np.abs(Y - y) < size_y / 2)
        heights[inside], labels[inside] = height, k
    return HeightMap(heights, np.ones(X.shape, bool), (0.0, 0.0), CELL), labels, ~WALL


def pushes(*boxes, settings=PushSettings(), avoid=()):
    seen, labels, where = bin_with(*boxes)
    return seen, pushes_off_walls(seen, labels, where, 0.0, HAND, settings, avoid)


BESIDE_WALL = (0.33, 0.143, 0.16, 0.044)  # its long side touches a wall


@pytest.mark.slow
def test_a_piece_beside_a_wall_is_pushed_away_from_it():
    _, found = pushes(BESIDE_WALL)
    assert found
    assert [p.score for p in found] == sorted((p.score for p in found), reverse=True)
    assert found[0].score > PushSettings().least_gain
    assert found[0].shift[1] > 0  # the wall is at smaller y
    assert abs(found[0].turn) > 0.02


@pytest.mark.slow
def test_the_closed_hand_starts_and_moves_in_free_space():
    """Independent of the kernel: the cells in the rectangle of the closed fingers."""
    seen, found = pushes(BESIDE_WALL, (0.49, 0.29, 0.04, 0.04))
    index = np.argwhere(np.isfinite(seen.heights))
    points = seen.at(index)
    fixed = points[(WALL | (X > 0.46) & (Y > 0.26))[index[:, 0], index[:, 1]]]
    fingers = np.concatenate([HAND.left, HAND.right])
    half_x, half_y = np.abs(fingers[:, [0, 3]]).max(), np.abs(fingers[:, [1, 4]]).max()
    for push in found:
        assert push.offset[2] == 0.0
        assert np.hypot(*push.offset[:2]) <= PushSettings().length + PushSettings().before + 2 * CELL
        for share, cells in ((0.0, points[points[:, 2] > 0.01]), (0.5, fixed), (1.0, fixed)):
            T = push.T_object_tcp.shifted(*(share * np.array(push.offset)))
            local = T.inverse().apply(cells)
            under = (np.abs(local[:, 0]) <= half_x) & (np.abs(local[:, 1]) <= half_y)
            assert not np.any(cells[under, 2] > 0.01)


@pytest.mark.slow
def test_a_push_faces_its_direction_with_a_side_of_the_fingers():
    _, found = pushes(BESIDE_WALL)
    R, along = found[0].T_object_tcp.rotation.matrix, np.array(found[0].offset)
    np.testing.assert_allclose(R[:, 0], along / np.linalg.norm(along), atol=1e-9)
    np.testing.assert_allclose(R[:, 2], (0, 0, -1), atol=1e-9)


@pytest.mark.slow
def test_a_piece_with_room_on_all_sides_is_not_pushed():
    assert pushes((0.33, 0.33, 0.04, 0.04))[1] == []


@pytest.mark.slow
def test_the_palm_stays_above_a_piece_as_tall_as_the_fingers_are_long():
    seen, labels, where = bin_with(BESIDE_WALL, height=0.06)
    found = pushes_off_walls(seen, labels, where, 0.0, HAND)
    assert found
    palm = float(HAND.palm[:, 5].max())
    assert all(push.T_object_tcp.translation[2] - palm > 0.06 + PushSettings().clearance for push in found)


@pytest.mark.slow
def test_an_earlier_push_comes_last():
    _, first = pushes(BESIDE_WALL)
    x, y, _ = first[0].T_object_tcp.translation
    _, second = pushes(BESIDE_WALL, avoid=[(x, y, first[0].angle)])
    assert second[0].name != first[0].name or second[0].score < 0


def test_maps_and_settings_that_do_not_fit_are_refused():
    seen, labels, where = bin_with(BESIDE_WALL)
    with pytest.raises(InputError, match="labels of"):
        pushes_off_walls(seen, labels[1:], where, 0.0, HAND)
    with pytest.raises(InputError, match="where of"):
        pushes_off_walls(seen, labels, where[1:], 0.0, HAND)
    with pytest.raises(InputError, match="length is 0"):
        PushSettings(length=0.0)
