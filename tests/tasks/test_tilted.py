"""Picked in physics and put on a board that leans: it stays where it was put."""

from __future__ import annotations

import numpy as np
import pytest
from tests.tasks.helpers import live, nominal

from armcell.core import SE3, SO3, Box, InputError
from armcell.scene import CollisionObject, PlanningScene


def with_board(degrees: float, towards: float) -> PlanningScene:
    """The cell with a board instead of its tray, that leans towards a direction [rad]; the cube has 0.6."""
    scene = nominal()
    at = scene.object("tray").T_world_object.translation
    turn = SO3.exp((0, 0, towards))
    R = turn @ SO3.exp((0, np.radians(degrees), 0)) @ turn.inverse()
    board = CollisionObject.single("board", Box(0.22, 0.22, 0.02), SE3(R, at).shifted(z=0.08))
    return scene.without_object("tray").with_object(board)


@pytest.mark.slow
@pytest.mark.cases("12-3.1", "20--0.8", "6-0.0")
@pytest.mark.parametrize(
    "degrees, towards", [(6, 0.0), (12, 1.6), (12, 3.1), (20, -0.8), (21, 0.0), (21, 2.4)]
)
def test_a_cube_put_on_a_leaning_board_stays(degrees, towards):
    with live("sim", with_board(degrees, towards)) as cell:
        outcome = cell.arm.pick("cube") and cell.arm.place("cube", on="board")
        assert outcome, outcome.message
        wanted = outcome.evidence["placement"].T_world_object
        cell.ctx.advance(5.0)
        moved, _ = wanted.distance_to(cell.driver.object_poses()["cube"])
        assert moved < 0.01
        up = cell.driver.object_poses()["cube"].rotation.matrix.T @ outcome.evidence["placement"].normal
        assert np.abs(up).max() > np.cos(0.03)  # flat on the board
        assert cell.driver.unwanted_contacts() == [] and cell.driver.welds() == []


def test_a_board_that_is_too_steep_is_refused_with_both_angles():
    with live("sim", with_board(24, 0.0)) as cell:
        assert cell.arm.pick("cube")
        with pytest.raises(InputError) as error:
            cell.arm.place("cube", on="board")
        assert "leans by 24.0 degrees" in str(error.value) and "21.8" in str(error.value)
        assert "friction" in error.value.hint
