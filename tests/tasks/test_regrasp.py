"""Objects that no single grasp turns as wanted: laid down in between, in physics, friction only."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.tasks.helpers import AtStage, live, nominal, panda_pick

from armcell.core import SE3, SO3, Box, ErrorCode, InputError
from armcell.grasping import stable_poses
from armcell.scene import CollisionObject, PlanningScene, library_object
from armcell.tasks import (
    IntermediatePlacement,
    PartialSolution,
    PickAndPlace,
    RecoverySettings,
    SearchState,
    Task,
)
from armcell.tasks.regrasp import PlacementGoal, regrasp_sequences

SINGLE = RecoverySettings(tries=1, intermediate_placements=0)
X, Y, Z = np.eye(3)
TABLE = -0.001  # [m] its top


def box(name: str, *size: float) -> CollisionObject:
    return CollisionObject.single(name, Box(*size), SE3.identity(), movable=True)


def scene_of(item: CollisionObject, up, x=0.5, y=-0.15, yaw=0.3) -> PlanningScene:
    """An object on a free table with one of its sides up."""
    table = CollisionObject.single("table", Box(1.0, 1.4, 0.04), SE3.from_xyz(0.5, 0, -0.021))
    side = max(stable_poses(item), key=lambda r: float(r.up @ up))
    R = SO3.exp((0, 0, yaw)) @ SO3.between(up, (0.0, 0.0, 1.0))
    pose = SE3(R, np.array([x, y, TABLE + side.height]))
    item = replace(item, T_world_object=pose, movable=True)
    scene = PlanningScene.of(nominal().model, objects=[table, item]).with_padding(0.003)
    return scene.with_state(scene.model.named_state("arm", "home"))


def body(cell, name):
    """The pose of the simulated body, from MuJoCo: rotation (3, 3) and place (3,)."""
    data = cell.driver.world.mj_data
    return data.body(name).xmat.reshape(3, 3), data.body(name).xpos


def lowest(cell, item: CollisionObject) -> float:
    """Height [m] of a box's lowest corner in physics."""
    R, at = body(cell, item.name)
    half = np.array(item.shapes[0][0].half_extents)
    return float(at[2] - np.abs(R[2]) @ half)


BRICK = box("brick", 0.10, 0.05, 0.04)
PLATE = box("plate", 0.08, 0.06, 0.03)  # the hand has no room beside it, whichever side is up


@pytest.mark.slow
@pytest.mark.cases("now1-then1")
@pytest.mark.parametrize(("now", "then"), [(Z, -Z), (Y, Z)])
def test_a_box_is_turned_that_no_single_grasp_turns(now, then):
    up = tuple(map(float, then))
    scene = scene_of(BRICK, now)
    with live("fake", scene) as cell:
        assert not cell.arm.transfer("brick", on="table", up=up, settings=SINGLE)
    with live("sim", scene) as cell:
        outcome = cell.arm.transfer("brick", on="table", at=(0.0, 0.2), up=up)
        assert outcome.ok, outcome.message
        assert outcome.evidence["intermediate_placements"] and outcome.evidence["tries"] == 1
        R, at = body(cell, "brick")
        assert R[2] @ then > 0.999
        assert np.abs(at[:2] - (0.5, 0.2)).max() < 0.03  # the grid around the point is 20 mm wide
        assert abs(lowest(cell, BRICK) - TABLE) < 1e-3
        T = cell.scene().object("brick").T_world_object
        np.testing.assert_allclose(T.translation, at, atol=1e-6)  # the scene has what physics moved
        assert not cell.driver.unwanted_contacts() and not cell.driver.welds() and not cell.ctx.holding


@pytest.mark.long
def test_where_it_really_lies_in_between_is_looked_at():
    """Somebody pushes it away as soon as it is laid down: it is found there, and ends where it should."""

    def push():
        pose = cell.driver.object_poses()["brick"]
        cell.driver.world.set_object_pose("brick", pose.shifted(0.03, 0.08, 0.0))

    with live("sim", scene_of(BRICK, Y)) as cell:
        cell.ctx.observers.append(AtStage("retreat", push))
        outcome = cell.arm.transfer("brick", on="table", at=(0.0, 0.2), up=(0.0, 0.0, 1.0))
        assert outcome.ok, outcome.message
        assert "lies 8" in outcome.evidence["troubles"][0]  # 85 mm, and what it slides then
        R, at = body(cell, "brick")
        assert R[2, 2] > 0.999 and np.abs(at[:2] - (0.5, 0.2)).max() < 0.03


@pytest.mark.long
def test_a_mug_is_turned_upside_down():
    mug = library_object("mug", "mug", SE3.identity())
    with live("sim", scene_of(mug, Z)) as cell:
        outcome = cell.arm.transfer("mug", on="table", at=(0.0, 0.2), up=(0.0, 0.0, -1.0))
        assert outcome.ok and outcome.evidence["intermediate_placements"], outcome.message
        R, _ = body(cell, "mug")
        assert R[2, 2] < -0.999
        assert not cell.driver.unwanted_contacts() and not cell.driver.welds()


@pytest.mark.slow
def test_what_the_hand_holds_by_the_wrong_grasp_is_laid_down_first():
    with live("sim", scene_of(BRICK, Y)) as cell:
        assert cell.arm.pick("brick")
        assert not cell.arm.place("brick", on="table", up=(0.0, 0.0, 1.0))  # held across z
        outcome = cell.arm.transfer("brick", on="table", up=(0.0, 0.0, 1.0))
        assert outcome.ok and outcome.evidence["intermediate_placements"], outcome.message
        assert body(cell, "brick")[0][2, 2] > 0.999


@pytest.mark.long
def test_no_way_at_all_is_said_and_nothing_moves():
    with live("sim", scene_of(PLATE, Z)) as cell:
        joints, pose = cell.driver.joint_state().positions, body(cell, "plate")[1].copy()
        outcome = cell.arm.transfer("plate", on="table", up=(0.0, 0.0, -1.0))
        assert outcome.code is ErrorCode.PLANNING_FAILED
        assert outcome.evidence["tries"] == 1 and not cell.ctx.reports
        assert "no object has moved" in outcome.message and "no grasp" in outcome.message
        told = [
            who
            for stage, who, _ in outcome.evidence["intermediate_placement"]["rejections"]
            if stage == "intermediate placement"
        ]
        assert len(told) == 6  # a line for each side
        np.testing.assert_allclose(cell.driver.joint_state().positions, joints, atol=1e-3)
        np.testing.assert_allclose(body(cell, "plate")[1], pose, atol=1e-4)


@pytest.mark.slow
def test_all_of_it_as_a_stage_of_a_task():
    """The way on from the lay-down is part of the plan; the object stands as wanted at its end."""
    scene = scene_of(BRICK, Z)
    gripper, settings = scene.model.gripper(), panda_pick().settings

    def plan(intermediate_placements):
        stage = PickAndPlace(
            "brick", "table", gripper, up=(0.0, 0.0, -1.0), intermediate_placements=intermediate_placements
        )
        return Task("turn", (stage,)).plan(PartialSolution(scene), SearchState(settings))

    assert plan(0).best is None
    best = plan(2).best
    assert best is not None and best.scene.object("brick").T_world_object.rotation.matrix[2, 2] < -0.999


def test_a_place_that_is_taken_is_said_without_a_search():
    post = CollisionObject.single("post", Box(0.3, 0.3, 0.1), SE3.from_xyz(0.5, 0.2, 0.05))
    scene = scene_of(BRICK, Z).with_object(post)
    planning = SearchState(panda_pick().settings)
    wanted = PlacementGoal("brick", "table", (0.0, 0.2), (0.0, 0.0, -1.0))
    assert not list(regrasp_sequences(scene, wanted, scene.model.gripper(), planning, 2))
    ((stage, _, reason),) = planning.rejections.details
    assert stage == "goal" and "would touch" in reason and "post" in reason


def test_misuse_is_said():
    with pytest.raises(InputError, match="intermediate_placements is -1"):
        RecoverySettings(intermediate_placements=-1)
    with pytest.raises(InputError, match="most is 0"):
        IntermediatePlacement("cube", "tray", nominal().model.gripper(), most=0)
