"""Drags that pull round pieces of a heap away from walls."""

from __future__ import annotations

import numpy as np
import pytest

from armcell.core import HeightMap, InputError
from armcell.grasping import DragSettings, drags_off_walls, hand_of
from armcell.model import load_robot

MODEL = load_robot("ur10_gripper")
HAND = hand_of(MODEL, MODEL.gripper())
CELL = 0.003
AXIS = CELL * np.arange(220)
X, Y = np.meshgrid(AXIS, AXIS, indexing="ij")
LOW, HIGH = 0.12, 0.54  # inside of the walls
WALL = (X < LOW) | (X > HIGH) | (Y < LOW) | (Y > HIGH)


def sphere(x, y, radius):
    square = radius**2 - (X - x) ** 2 - (Y - y) ** 2
    return np.where(square > 0, radius + np.sqrt(np.maximum(square, 0)), 0.0)


def can(x, y, radius, length):
    """A can that lies along y."""
    square = np.where(np.abs(Y - y) < length / 2, radius**2 - (X - x) ** 2, -1.0)
    return np.where(square > 0, radius + np.sqrt(np.maximum(square, 0)), 0.0)


def box(x, y, size_x, size_y, height):
    return np.where((np.abs(X - x) < size_x / 2) & (np.abs(Y - y) < size_y / 2), height, 0.0)


def drags(*pieces, avoid=()):
    heights, labels = np.where(WALL, 0.06, 0.0), np.full(X.shape, -1)
    for k, piece in enumerate(pieces):
        inside = (piece > 0) & ~WALL
        heights[inside], labels[inside] = piece[inside], k
    seen = HeightMap(heights, np.ones(X.shape, bool), (0.0, 0.0), CELL)
    return seen, drags_off_walls(seen, labels, ~WALL, 0.0, HAND, DragSettings(), avoid)


CORNERED = sphere(LOW + 0.022, LOW + 0.022, 0.022)


@pytest.mark.slow
@pytest.mark.parametrize("piece", [CORNERED, can(LOW + 0.027, LOW + 0.036, 0.027, 0.07)])
def test_a_round_piece_in_a_corner_is_dragged_out_of_the_corner(piece):
    _, found = drags(piece)
    assert found
    assert [d.score for d in found] == sorted((d.score for d in found), reverse=True)
    assert found[0].pull[0] > 0 and found[0].pull[1] > 0 and found[0].pull[2] == 0.0
    assert found[0].offset[:2] == (0.0, 0.0) and found[0].offset[2] < 0


@pytest.mark.slow
def test_only_one_fingertip_touches_the_piece_and_nothing_touches_the_walls():
    """Independent of the search: the cells under the fingers, at the start and at the end of the pull."""
    seen, found = drags(CORNERED, box(0.40, 0.40, 0.04, 0.04, 0.03))
    index = np.argwhere(np.isfinite(seen.heights))
    points = seen.at(index)
    dragged = (CORNERED > 0)[index[:, 0], index[:, 1]]
    for drag in found:
        lowest = drag.T_object_tcp.translation[2] - 0.012 + drag.offset[2]
        for pull in (np.zeros(3), np.array(drag.pull)):
            local = drag.T_object_tcp.shifted(*pull).inverse().apply(points)
            under = np.abs(local[:, 0]) <= 0.011
            rear = under & (local[:, 1] < -drag.opening / 2) & (local[:, 1] > -drag.opening / 2 - 0.012)
            front = under & (local[:, 1] > drag.opening / 2) & (local[:, 1] < drag.opening / 2 + 0.012)
            assert points[(rear | front) & ~dragged, 2].max() < lowest
            assert not np.any(front & dragged)
            if not pull.any():
                assert points[rear & dragged, 2].max() > lowest + DragSettings().press / 2


@pytest.mark.slow
def test_a_flat_box_and_a_piece_with_room_on_all_sides_are_not_dragged():
    assert drags(box(LOW + 0.03, LOW + 0.06, 0.06, 0.12, 0.04))[1] == []
    assert drags(sphere(0.33, 0.33, 0.022))[1] == []


@pytest.mark.slow
def test_a_piece_that_two_drags_did_not_free_is_not_dragged_again():
    far = sphere(HIGH - 0.022, HIGH - 0.022, 0.022)
    _, found = drags(CORNERED, far)
    near, other = (np.hypot(*np.subtract(d.contact, LOW)) < 0.1 for d in (found[0], found[-1]))
    assert near != other
    assert len(drags(CORNERED, far, avoid=[found[0].contact])[1]) == len(found)
    _, again = drags(CORNERED, far, avoid=[found[0].contact] * 2)
    assert again and all((np.hypot(*np.subtract(d.contact, LOW)) < 0.1) == other for d in again)


@pytest.mark.slow
def test_noise_does_not_make_a_flat_box_round():
    rng = np.random.default_rng(0)
    noisy = box(LOW + 0.03, LOW + 0.06, 0.06, 0.12, 0.04)
    noisy[noisy > 0] += rng.normal(0.0, 0.0015, np.count_nonzero(noisy))
    assert drags(noisy)[1] == []


def test_labels_of_another_size_are_refused():
    seen = HeightMap(np.zeros(X.shape), np.ones(X.shape, bool), (0.0, 0.0), CELL)
    with pytest.raises(InputError, match="labels of"):
        drags_off_walls(seen, np.full((2, 2), -1), ~WALL, 0.0, HAND)
