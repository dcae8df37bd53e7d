"""Sorting by what a camera sees: in physics, judged by the simulator's truth, which the task does not see."""

from __future__ import annotations

import numpy as np
import pytest
from tests.tasks.helpers import AtStage

import armcell
from armcell.core import ErrorCode, InputError, UnknownNameError
from armcell.tasks import SortSettings

MATS = {"red_mat": 0.33, "blue_mat": -0.33}  # [m] y of their middles
THINGS = ("red_box", "blue_box", "red_can", "blue_can")


def where(cell) -> dict[str, str]:
    """On which mat each thing really is."""
    found = {}
    for name in THINGS:
        at = cell.driver.world.object_pose(name).translation
        on = [m for m, y in MATS.items() if abs(at[1] - y) < 0.1 and abs(at[0] - 0.75) < 0.11]
        found[name] = on[0] if on and 0.22 < at[2] < 0.26 else ""
    return found


@pytest.fixture(scope="module")
def sorting():
    return armcell.load("six_axis_sort")


@pytest.mark.slow
@pytest.mark.cases("shape-*")
@pytest.mark.parametrize(
    ("by", "into", "word"),
    [
        ("color", {"red": "red_mat", "blue": "blue_mat"}, 0),
        ("shape", {"cylinder": "red_mat", "box": "blue_mat"}, 1),
    ],
)
def test_everything_gets_to_its_mat(sorting, by, into, word):
    names = {"red": "red", "blue": "blue", "cylinder": "can", "box": "box"}
    with sorting.connect(seed=3) as cell:
        assert not any(name in cell.scene().objects for name in THINGS)  # nobody has looked yet
        outcome = cell.sort(into, camera="above", by=by)
        assert outcome.ok, outcome.message
        expected = {names[kind]: mat for kind, mat in into.items()}
        assert where(cell) == {name: expected[name.split("_")[word]] for name in THINGS}
        assert not cell.driver.unwanted_contacts() and not cell.driver.welds()
        assert sorted(n for names in outcome.evidence["sorted"].values() for n in names) == sorted(THINGS)


@pytest.mark.long
def test_what_is_knocked_out_of_the_hand_is_seen_and_sorted_again(sorting):
    """The hand opens on the way; things of one color have no place and stay."""
    with sorting.connect(seed=4) as cell:
        hand = cell.model.gripper()
        drop = AtStage("lift", lambda: cell.driver.command_gripper(hand.name, hand.max_width, hand.max_force))
        cell.ctx.observers.append(drop)
        before = {n: cell.driver.world.object_pose(n).translation for n in ("blue_box", "blue_can")}
        outcome = cell.sort({"red": "red_mat"}, camera="above", settings=SortSettings(tries=3))
        assert outcome.ok, outcome.message
        assert where(cell)["red_box"] == where(cell)["red_can"] == "red_mat"
        assert set(outcome.evidence["other"].values()) == {"blue"}
        for name, at in before.items():
            np.testing.assert_allclose(cell.driver.world.object_pose(name).translation, at, atol=2e-3)


def test_names_that_do_not_exist(sorting):
    with sorting.connect(seed=3) as cell:
        with pytest.raises(UnknownNameError, match="property to sort by 'size'; known: color, shape"):
            cell.sort({"red": "red_mat"}, camera="above", by="size")
        with pytest.raises(UnknownNameError, match="unknown object 'rad_mat'"):
            cell.sort({"red": "rad_mat"}, camera="above")
        with pytest.raises(InputError, match="no destinations are given"):
            cell.sort({}, camera="above")


@pytest.mark.slow
def test_a_frozen_camera_ends_it_with_its_reason(sorting):
    with sorting.connect(seed=3) as cell:
        cell.camera("above").image()
        cell.camera("above").frozen = True
        cell.ctx.advance(1.0)
        outcome = cell.sort({"red": "red_mat"}, camera="above")
    assert outcome.code is ErrorCode.SENSOR_INFO_STALE and "old" in outcome.message
