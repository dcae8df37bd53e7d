"""The height at which an object rests on the objects below it."""

from __future__ import annotations

import pytest

from armcell.collision import resting_shift
from armcell.core import SE3, Box
from armcell.model import load_robot
from armcell.scene import CollisionObject, PlanningScene

MOST = 0.005


def scene(height, *others):
    """A cube of 5 cm whose lower face is at a height above a table at z = 0."""
    table = CollisionObject.single("table", Box(1.0, 1.0, 0.1), SE3.from_xyz(0.5, 0.0, -0.05))
    cube = CollisionObject.single(
        "cube", Box(0.05, 0.05, 0.05), SE3.from_xyz(0.5, 0.0, 0.025 + height), movable=True
    )
    return PlanningScene.of(load_robot("panda"), objects=[table, cube, *others])


@pytest.mark.parametrize("height", [-0.005, -0.003, 0.003, 0.005])
def test_a_cube_above_or_inside_the_table_moves_onto_it(height):
    assert resting_shift(scene(height), "cube", MOST) == pytest.approx(-height, abs=1e-5)


@pytest.mark.parametrize("height", [-0.0019, 0.0, 0.0019])
def test_a_cube_at_rest_stays(height):
    assert resting_shift(scene(height), "cube", MOST) == 0.0


@pytest.mark.parametrize("height", [-0.02, 0.01, 0.3])
def test_a_larger_distance_is_not_corrected(height):
    assert resting_shift(scene(height), "cube", MOST) == 0.0


def test_an_overlap_at_the_side_is_not_corrected():
    wall = CollisionObject.single("wall", Box(0.02, 0.2, 0.2), SE3.from_xyz(0.53, 0.0, 0.1))
    assert resting_shift(scene(0.0, wall), "cube", MOST) == 0.0


def test_without_an_allowed_error_nothing_is_corrected():
    assert resting_shift(scene(0.004), "cube", 0.0) == 0.0
