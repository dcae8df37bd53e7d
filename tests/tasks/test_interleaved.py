"""Parts planned while the one before is performed: from what should be, again where it is not."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from tests.tasks.helpers import AtStage, live, nominal, stages, teleport, with_cube

from armcell.core import SE3, Box, ErrorCode, InputError
from armcell.scene import CollisionObject
from armcell.tasks import PipelinedTask, perform_pipelined, picking, placing
from armcell.tasks.pipelined import scene_difference
from armcell.tasks.stages import RunSteps
from armcell.tasks.steps import DONE


def there_and_back(hand):
    return [picking("cube", hand), placing("cube", "tray", hand), picking("cube", hand)]


class Log:
    """A stage that notes in which thread it was planned and what it was given."""

    name = "log"

    def __init__(self, seen):
        self.seen = seen

    def propose(self, solution, planning):
        self.seen.append((threading.current_thread(), solution.scene))
        yield solution


def test_the_next_part_is_planned_while_this_one_is_performed():
    seen, waited = [], threading.Event()

    class Wait:
        """A step that ends when the next part has been planned: it never would one after another."""

        def perform(self, ctx):
            assert waited.wait(30.0)
            return DONE

    class Tell(Log):
        def propose(self, solution, planning):
            waited.set()
            yield from super().propose(solution, planning)

    parts = [
        PipelinedTask("first", lambda ctx, scene: [RunSteps("wait", (Wait(),))]),
        PipelinedTask("second", lambda ctx, scene: [Tell(seen)]),
    ]
    with live() as cell:
        outcome = perform_pipelined(cell.ctx, parts)
    assert outcome.ok and outcome.evidence == {"performed": ["first", "second"], "ahead": 1, "again": {}}
    assert seen[0][0] is not threading.main_thread()


def test_pick_place_pick_by_plans_made_ahead():
    with live() as cell:
        hand = cell.model.gripper()
        outcome = perform_pipelined(cell.ctx, there_and_back(hand))
        assert outcome.ok, outcome.message
        assert outcome.evidence["ahead"] == 2 and outcome.evidence["again"] == {}
        assert "cube" in cell.ctx.holding
        assert stages(cell).count("lift") == 2


@pytest.mark.slow
@pytest.mark.cases("0.0")
@pytest.mark.parametrize("moved", [0.0, 0.04])
def test_what_was_moved_meanwhile_is_planned_for_again(moved):
    """In physics: while the cube is put down, somebody moves another one that is to be picked next."""
    other = CollisionObject.single(
        "other", Box(0.04, 0.04, 0.04), SE3.from_xyz(0.4, -0.3, 0.0195), movable=True
    )
    scene = with_cube().with_object(other)

    def push():
        world = cell.driver.world
        world.set_object_pose("other", world.object_pose("other").shifted(moved, 0.0, 0.0))

    with live("sim", scene, observers=[AtStage("lower", push)]) as cell:
        hand = cell.model.gripper()
        parts = [picking("cube", hand), placing("cube", "tray", hand), picking("other", hand)]
        outcome = perform_pipelined(cell.ctx, parts)
        assert outcome.ok, outcome.message
        again = outcome.evidence["again"]
        assert ("pick other" in again) == (moved > 0)
        if moved:
            assert again["pick other"].startswith("other is 40")
        assert cell.driver.gripper(hand.name).held == "other"
        assert not cell.driver.unwanted_contacts()


def test_a_part_that_fails_ends_it_and_is_named():
    with live("sim", observers=[AtStage("close", lambda: teleport(cell, 0.0, 0.3))]) as cell:
        hand = cell.model.gripper()
        outcome = perform_pipelined(cell.ctx, there_and_back(hand))
    assert outcome.code is ErrorCode.CONTROL_FAILED
    assert outcome.message.startswith("pick cube: grasp failed: nothing is between the fingers")
    assert outcome.evidence["performed"] == []


def test_a_part_that_cannot_be_planned_says_why_after_those_before_it():
    tray = nominal().object("tray").T_world_object
    with live(scene=nominal().with_object_pose("tray", tray.shifted(0.0, 2.0))) as cell:
        outcome = perform_pipelined(cell.ctx, there_and_back(cell.model.gripper()))
    assert outcome.code is ErrorCode.PLANNING_FAILED and outcome.message.startswith("place cube on tray: ")
    assert "out of reach" in outcome.message
    assert outcome.evidence["performed"] == ["pick cube"] and outcome.evidence["stages"]


def test_cancelled_while_planning_ahead():
    with live(observers=[AtStage("lift", lambda: cell.ctx.cancel.set())]) as cell:
        outcome = perform_pipelined(cell.ctx, there_and_back(cell.model.gripper()))
    assert outcome.code is ErrorCode.PREEMPTED


def test_an_error_of_the_thread_is_raised_in_the_task():
    with live() as cell, pytest.raises(InputError, match="unknown object 'cub'"):
        perform_pipelined(cell.ctx, [picking("cub", cell.model.gripper())])


def test_which_changes_count():
    scene = nominal()
    cube = scene.object("cube").T_world_object
    assert scene_difference(scene, scene) == ""
    assert scene_difference(scene, scene.with_object_pose("cube", cube.shifted(0.002))) == ""
    assert "cube is 5.0 mm" in scene_difference(scene, scene.with_object_pose("cube", cube.shifted(0.005)))
    turned = cube @ SE3.from_xyz_rpy((0, 0, 0), (0, 0, 0.1))
    assert "5.7 deg" in scene_difference(scene, scene.with_object_pose("cube", turned))
    assert "wall appeared or disappeared" in scene_difference(scene, scene.without_object("wall"))
    hand = scene.model.gripper()
    held = scene.with_attached("cube", hand.tcp_link, hand.hand_links)
    assert scene_difference(held, scene) and scene_difference(scene, held)
    names = scene.model.group(hand.arm_group).joint_names
    q = scene.state.reindexed(names)
    moved = scene.with_state(type(q)(names, q.positions + np.eye(len(names))[2] * 0.05))
    assert "0.050 from its predicted position" in scene_difference(scene, moved)
