"""Picking from a running belt, in physics."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from tests.sizes import seeds
from tests.tasks.helpers import AtStage, notes

import armcell
from armcell.cell import run_task
from armcell.core import SE3, Box, InputError
from armcell.model import load_robot
from armcell.scene import CollisionObject, PlanningScene
from armcell.sim import SimWorld
from armcell.tasks import ConveyorPickSettings


@cache
def conveyor():
    return armcell.load("conveyor_pick")


@pytest.mark.parametrize("velocity", [(0.0, 0.1, 0.0), (-0.2, 0.0, 0.0)])
def test_a_belt_carries_what_lies_on_it_and_stays_where_it_is(velocity):
    belt = CollisionObject.single("belt", Box(1, 1, 0.02), SE3.from_xyz(1.0, 0, 0.19), belt=velocity)
    box = CollisionObject.single("box", Box(0.05, 0.05, 0.05), SE3.from_xyz(1.0, 0, 0.225), movable=True)
    model = load_robot("ur10_gripper")
    scene = PlanningScene.of(model, objects=[belt, box]).with_state(model.named_state("arm", "up"))
    world = SimWorld(scene)
    world.step(250)  # half a second, to come to speed
    before = world.object_pose("box").translation
    world.step(500)
    np.testing.assert_allclose(world.object_pose("box").translation - before, velocity, atol=1e-3)
    assert world.object_pose("belt").isclose(belt.T_world_object, 1e-3, 1e-9)


@pytest.mark.parametrize("wrong", [{"belt": (0, 0, 0)}, {"belt": (0, 0.1, 0), "movable": True}])
def test_a_belt_that_cannot_be_is_said(wrong):
    with pytest.raises(InputError, match="fixed object's surface"):
        CollisionObject.single("belt", Box(1, 1, 0.1), **wrong)


def test_what_cannot_be_picked_on_the_way_is_said():
    with conveyor().connect("fake") as cell:
        with pytest.raises(InputError, match="does not move"):
            cell.arm.pick_moving("box_1")
        with pytest.raises(InputError, match="fixed"):
            cell.arm.pick_moving("tray")
    with pytest.raises(InputError, match="approach"):
        ConveyorPickSettings(approach=0.0)


@pytest.mark.slow
def test_what_is_past_is_not_chased():
    with conveyor().connect("sim", seed=0) as cell:
        cell.driver.world.set_object_pose("box_1", SE3.from_xyz(0.8, 1.0, 0.2455))
        cell.ctx.advance(0.5)
        outcome = cell.arm.pick_moving("box_1")
        assert not outcome.ok and "box_1 on the way" in outcome.message
        assert cell.driver.unwanted_contacts() == []


@pytest.mark.slow
def test_a_miss_is_tried_again_farther_on():
    with conveyor().connect("sim", seed=0) as cell:
        world = cell.driver.world

        def push():
            world.set_object_pose("box_1", world.object_pose("box_1").shifted(y=-0.35))

        cell.ctx.observers.append(AtStage("along with it", push))
        outcome = cell.arm.pick_moving("box_1")
        assert outcome.ok, outcome.message
        assert any("trying again farther on" in text for text in notes(cell))
        assert cell.driver.gripper("gripper").held == "box_1"


@pytest.mark.slow
@pytest.mark.parametrize("seed", seeds(1, [0, 3]))
def test_both_boxes_end_in_the_tray(seed):
    cell = conveyor()
    with cell.connect("sim", seed=seed) as live:
        result = run_task(cell, live, seed, "sim")
        assert result["success"], result["message"]
        assert result["unwanted_contacts"] == [] and result["welds"] == []
        tray = cell.scene().object("tray").T_world_object.inverse()
        for name in ("box_1", "box_2"):
            local = tray.apply(live.driver.world.object_pose(name).translation)
            assert abs(local[0]) < 0.2 and abs(local[1]) < 0.15 and 0 < local[2] < 0.06
