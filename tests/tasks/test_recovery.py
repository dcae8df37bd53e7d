"""Transfers in physics in which something goes wrong: they end where they should, or say why not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.tasks.helpers import (
    AtStage,
    Freezable,
    live,
    nominal,
    notes,
    panda_pick,
    prison,
    stages,
    teleport,
    with_cube,
)

from armcell.cell.value_overrides import with_values
from armcell.core import SE3, Box, ErrorCode, InputError
from armcell.scene import CollisionObject, Material, PlanningScene
from armcell.tasks import Lookahead, RecoverySettings
from armcell.tasks.search import PartialSolution, SearchState, search

SETTINGS = panda_pick().settings


def in_tray(cell, item="cube"):
    local = (
        nominal().object("tray").T_world_object.inverse().apply(cell.driver.object_poses()[item].translation)
    )
    return bool(np.abs(local[:2]).max() < 0.12 and 0 < local[2] < 0.06)


def let_go(cell):
    """The hand opens by itself."""
    cell.driver.world.set_gripper_target("hand", 0.08)


@pytest.mark.slow
@pytest.mark.cases("lift")
@pytest.mark.parametrize("stage", ["lift", "move to pre-place"])
def test_what_is_dropped_is_picked_up_where_it_fell(stage):
    with live("sim") as cell:
        cell.ctx.observers.append(AtStage(stage, lambda: let_go(cell)))
        outcome = cell.arm.transfer("cube", on="tray")
        assert outcome.ok, outcome.message
        assert in_tray(cell) and not cell.ctx.holding
        assert any("lost cube" in text for text in notes(cell, "grasp"))
        assert cell.driver.unwanted_contacts() == []


@pytest.mark.slow
def test_a_loss_on_the_way_stops_the_arm_within_a_moment():
    with live("sim") as cell:
        assert cell.arm.pick("cube").ok
        lost = []

        def take_away():
            teleport(cell, -0.1, 0.0)
            lost.append(cell.driver.now)

        cell.ctx.observers.append(AtStage("move to pre-place", take_away))
        assert not cell.arm.place("cube", on="tray").ok
        assert cell.ctx.reports[-1].name == "move to pre-place"
        assert cell.driver.now - lost[0] < 0.5  # the whole motion takes more than a second
        assert not cell.ctx.holding


@pytest.mark.slow
def test_an_object_moved_after_planning_is_found_again():
    with live("sim") as cell:
        cell.ctx.observers.append(AtStage("move to pre-grasp", lambda: teleport(cell, -0.12, 0.05)))
        outcome = cell.arm.transfer("cube", on="tray")
        assert outcome.ok, outcome.message
        assert in_tray(cell)


@pytest.mark.slow
def test_a_landing_elsewhere_is_put_right():
    with live("sim") as cell:
        cell.ctx.observers.append(AtStage("retreat", lambda: teleport(cell, 0.0, -0.45)))
        outcome = cell.arm.transfer("cube", on="tray")
        assert outcome.ok, outcome.message
        assert outcome.evidence["tries"] == 2
        assert "lies 450 mm" in outcome.evidence["troubles"][0]
        assert in_tray(cell)


@pytest.mark.slow
def test_a_place_that_fails_on_the_way_is_planned_again():
    from armcell.execution import ExecutionSettings

    settings = replace(SETTINGS, execution=ExecutionSettings(path_tolerance=0.03))
    with live("sim", settings=settings) as cell:
        driver = cell.ctx.driver = Freezable(cell.driver)
        assert cell.arm.pick("cube").ok
        cell.ctx.observers += [
            AtStage("move to pre-place", lambda: driver.freeze("panda_joint1")),
            AtStage("move to pre-place", driver.thaw, nth=2),
        ]
        outcome = cell.arm.place("cube", on="tray")
        assert outcome.ok, outcome.message
        assert any("planning again from here" in text for text in notes(cell))
        assert stages(cell).count("move to pre-place") == 2
        assert in_tray(cell)


@pytest.mark.slow
def test_a_weak_gripper_is_given_up_with_its_reason():
    slippery = with_cube(mass=0.5, material=Material(0.035))
    with live("sim", slippery) as cell:
        outcome = cell.arm.transfer("cube", on="tray", settings=RecoverySettings(tries=1))
        assert not outcome.ok
        assert "given up after 1 tries" in outcome.message and "lost cube" in outcome.message
        assert not cell.ctx.holding and cell.driver.unwanted_contacts() == []


@pytest.mark.long
def test_no_way_is_given_up_at_once():
    settings = replace(SETTINGS, planning_time=0.05, planning_budget=1.0)
    with live("fake", prison(), settings=settings) as cell:
        outcome = cell.arm.transfer("cube", on="table", settings=RecoverySettings(tries=2))
        assert outcome.code in (ErrorCode.PLANNING_FAILED, ErrorCode.TIMED_OUT)
        assert "given up, because no object has moved" in outcome.message  # a second try would be the same
        assert outcome.evidence["tries"] == 1 and len(outcome.evidence["troubles"]) == 1


def test_misuse_is_said():
    with live("fake") as cell:
        with pytest.raises(InputError, match="itself"):
            cell.arm.transfer("cube", on="cube")
        with pytest.raises(InputError, match="unknown object"):
            cell.arm.transfer("ball", on="tray")
    with pytest.raises(InputError, match="tries"):
        RecoverySettings(tries=0)


# --- other sides ---
def lying_box() -> PlanningScene:
    """A box that lies on a free table."""
    table = CollisionObject.single("table", Box(1.2, 1.4, 0.04), SE3.from_xyz(0.5, 0, -0.021))
    box = CollisionObject.single("box", Box(0.10, 0.04, 0.05), SE3.from_xyz(0.5, -0.15, 0.024), movable=True)
    scene = PlanningScene.of(nominal().model, objects=[table, box]).with_padding(0.003)
    return scene.with_state(scene.model.named_state("arm", "home"))


def up_of(cell, axis):
    return float(cell.driver.object_poses()["box"].rotation.matrix[2] @ np.asarray(axis, float))


@pytest.mark.slow
def test_an_object_is_put_with_another_side_up():
    """Of the grasps only those are used with which the hand stays off the table where the box is stood up."""
    axis = (1, 0, 0)
    with live("sim", lying_box()) as cell:
        assert up_of(cell, axis) < 0.1
        outcome = cell.arm.transfer("box", on="table", up=axis)
        assert outcome.ok, outcome.message
        assert up_of(cell, axis) > 0.99
        assert cell.driver.unwanted_contacts() == []


def test_a_side_on_which_it_does_not_stand_is_refused():
    with live("fake", lying_box()) as cell:
        outcome = cell.arm.transfer("box", on="table", up=(1.0, 1.0, 0.0), settings=RecoverySettings(tries=1))
        assert not outcome.ok and "does not stand with that side up" in outcome.message


class Choice:
    """A stage that offers values."""

    def __init__(self, name, *values):
        self.name, self.values = name, values

    def propose(self, solution, planning):
        for value in self.values:
            yield solution.then(**{self.name: value})


class Only:
    """A stage that has a way from one value only."""

    name = "only"

    def __init__(self, of, value):
        self.of, self.value = of, value

    def propose(self, solution, planning):
        if solution.data[self.of] == self.value:
            yield solution.then(seen=True)
        else:
            planning.reject(self.name, str(solution.data[self.of]), "no")


def test_a_stage_that_foresees_keeps_only_what_goes_on():
    planning = SearchState(SETTINGS)
    solution = search(
        [Choice("a", 1, 2, 3), Lookahead("later", (Only("a", 3),))], PartialSolution(nominal()), planning
    )
    assert solution is not None and solution.data["a"] == 3
    assert "seen" not in solution.data  # nothing of what was tried ahead is kept
    assert [reason for stage, _, reason in planning.rejections.details if stage == "later"]


@pytest.mark.slow
def test_a_place_that_ends_on_its_support_is_planned_again_from_there():
    """A heavy cube slips on the way, comes to stand on the tray before the arm is where it should be, and the
    motion fails: the next one begins in contact with the tray, 0.0 mm deep."""
    cell_file = with_values(panda_pick(), {"objects.cube.mass": 3.0})
    with cell_file.connect("sim", seed=0) as cell:
        assert cell.arm.pick("cube").ok
        assert cell.arm.hold(5.0).ok
        ctx = cell.ctx

        def be_lenient():
            execution = replace(ctx.settings.execution, goal_tolerance=0.01)
            ctx.settings = replace(ctx.settings, execution=execution)

        ctx.observers.append(AtStage("lower", be_lenient, nth=2))
        outcome = cell.arm.place("cube", on="tray")
        assert outcome.ok, outcome.message
        reports = [r for r in ctx.reports if r.name in ("move to pre-place", "lower")]
        assert [r.ok for r in reports] == [True, False, True, True]
        assert "from the goal" in reports[1].error
        assert in_tray(cell) and cell.driver.unwanted_contacts() == []
