"""Dropping objects into a bin in physics."""

from __future__ import annotations

import pytest
from tests.cell.test_bin_clearing import whole

from armcell.cell import Cell, dropped_objects
from armcell.cell.dropped_objects import drop_objects
from armcell.cell.validation import validated
from armcell.core import SE3, Box, InputError, UnknownNameError
from armcell.scene import CollisionObject


@pytest.mark.slow
def test_what_a_seed_drops_lies_in_the_bin_and_is_the_same_every_time():
    cell = whole()
    scene, again = cell.scene(3), cell.scene(3)
    nominal, other = cell.scene(), cell.scene(4)
    turned = 0
    for name in cell.spec.drop.objects:
        T = scene.object(name).T_world_object
        assert T.isclose(again.object(name).T_world_object, 0.0, 0.0)
        assert not T.isclose(other.object(name).T_world_object, 1e-3, 1e-3)
        assert abs(T.translation[0] - 0.70) < 0.22 and abs(T.translation[1] + 0.32) < 0.24
        turned += (
            abs(T.rotation.matrix[2, 2] - nominal.object(name).T_world_object.rotation.matrix[2, 2]) > 0.5
        )
    assert turned > 5  # most do not stand as they are described


def test_objects_that_wait_for_their_drop_stand_on_the_shelf(monkeypatch):
    """The frame of a cube is in its middle: at the shelf's height, half of the cube would be in the shelf."""
    worlds = []

    def first_world(scene, settings):
        worlds.append(scene)
        raise InputError("enough")

    monkeypatch.setattr(dropped_objects, "SimWorld", first_world)
    cube = CollisionObject.single("cube", Box(0.04, 0.04, 0.04), SE3.identity(), movable=True, mass=0.05)
    with pytest.raises(InputError, match="enough"):
        drop_objects(whole().scene().with_object(cube), ["cube"], "bin", seed=0)
    assert 0.02 < worlds[0].object("cube").T_world_object.translation[2] < 0.022


@pytest.mark.slow
def test_what_was_dropped_is_at_rest():
    with whole().connect("sim", seed=3) as live:
        world = live.driver.world
        before = {n: world.object_pose(n) for n in whole().spec.drop.objects}
        world.step(500)
        moved = [before[n].distance_to(world.object_pose(n))[0] for n in before]
    assert max(moved) < 2e-3


@pytest.mark.parametrize(
    "change, says",
    [
        ({"into": "floor", "objects": ["nothing"]}, "nothing"),
        ({"into": "box_1", "objects": ["can_1"]}, "must be fixed"),
        ({"into": "bin", "objects": ["work_table"]}, "must be movable"),
    ],
)
def test_a_drop_that_cannot_be_is_said(change, says):
    data = whole().spec.model_dump(exclude_unset=True)
    data["drop"] = change
    with pytest.raises((InputError, UnknownNameError), match=says):
        Cell("wrong", whole().file, validated(data, whole().file))
