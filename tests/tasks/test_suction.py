"""Picking with suction cups: held, refused, dropped and lost, with the reason from the cups' readings."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest
from tests.tasks.helpers import PICK_STAGES, PLACE_STAGES, AtStage

import armcell
from armcell.cell import LiveCell
from armcell.core import SE3, Box, ErrorCode
from armcell.drivers import DriverOptions, drivers
from armcell.grasping import grasp_candidates, hand_of
from armcell.scene import CollisionObject, Material, PlanningScene
from armcell.tasks import TaskSettings, prove_grasps

OBSERVED = TaskSettings(attempts=1)


@cache
def scene(mass: float = 0.8) -> PlanningScene:
    model = armcell.load_robot("ur10_suction")
    table = CollisionObject.single("table", Box(1.2, 1.2, 0.04), SE3.from_xyz(0.7, 0.0, 0.10))
    box = CollisionObject.single(
        "box", Box(0.15, 0.12, 0.1), SE3.from_xyz(0.7, -0.2, 0.1705), movable=True, mass=mass,
        material=Material(0.5),
    )  # fmt: skip
    found = PlanningScene.of(model, objects=[table, box]).with_padding(0.003)
    return found.with_state(model.named_state("arm", "home"))


def live(mode: str, mass: float = 0.8, observers=(), settings=OBSERVED) -> LiveCell:
    return LiveCell("test", scene(mass), drivers[mode](scene(mass), DriverOptions()), settings, observers, 0)


@pytest.mark.slow
@pytest.mark.cases("sim")
@pytest.mark.parametrize("mode", ("fake", "sim"))
def test_pick_and_place(mode):
    with live(mode) as cell:
        picked = cell.arm.pick("box")
        assert picked.ok, picked.message
        reading = cell.driver.gripper("vacuum")
        assert reading.held == "box" and reading.width == 0.0
        assert reading.sealed == (2, 2) and reading.vacuum == pytest.approx(60.0, rel=0.01)
        assert cell.arm.hold(1.0).ok and cell.ctx.reports[-1].slip_m < 1e-4
        placed = cell.arm.place("box", on="table", at=(0.0, 0.2))
        assert placed.ok, placed.message
        reading = cell.driver.gripper("vacuum")
        assert reading.held is None and reading.vacuum == 0.0 and reading.width > 0.0
        target = placed.evidence["placement"].T_world_object
        assert target.distance_to(cell.driver.object_poses()["box"])[0] < 1e-3
        names = [r.name for r in cell.ctx.reports]
        assert names == [*PICK_STAGES, "hold", *PLACE_STAGES]
        assert cell.driver.welds() == []
        assert mode == "fake" or not cell.driver.unwanted_contacts()


@pytest.mark.slow
def test_a_heavy_object_is_refused_before_the_arm_moves():
    with live("sim", mass=6.0) as cell:
        before = cell.driver.joint_state().positions
        outcome = cell.arm.pick("box")
        assert outcome.code is ErrorCode.PLANNING_FAILED
        assert "needs 154 N, 2 times the load of 77 N; the vacuum of 2 cups pulls 122 N" in outcome.message
        assert cell.driver.now == 0.0 and (cell.driver.joint_state().positions == before).all()


@pytest.mark.slow
@pytest.mark.parametrize(("heavier", "holds"), [(3.0, True), (17.0, False)])
def test_an_object_heavier_than_believed_is_held_up_to_the_bound(heavier, holds):
    """Believed 0.8 kg; the cups pull 122 N, the weight is 24 N or 133 N."""
    with live("sim") as cell:
        world = cell.driver.world
        body = world.built.body["box"]
        world.mj_model.body_mass[body] *= heavier
        world.mj_model.body_inertia[body] *= heavier
        outcome = cell.arm.pick("box")
        assert outcome.ok == holds, outcome.message
        if not holds:
            assert "nothing is on the cups" in outcome.message or "it rose" in outcome.message


@pytest.mark.slow
def test_a_vacuum_that_fails_on_the_way_loses_the_object():
    def fail():
        cell.driver.world.set_gripper_target("vacuum", 0.01)

    with live("sim", observers=[AtStage("move to pre-place", fail)]) as cell:
        assert cell.arm.pick("box").ok
        outcome = cell.arm.place("box", on="table", at=(0.0, 0.2))
        assert outcome.code is ErrorCode.CONTROL_FAILED
        assert (
            "lost box on the way (move to pre-place): nothing is on the cups (measured: 0 of 2 hold"
            in outcome.message
        )
        assert "box" in cell.ctx.lost


@pytest.mark.slow
def test_proofs_tell_firm_grasps_from_leaking_and_overloaded_ones():
    model, item = scene().model, scene().object("box")
    grasps, _ = grasp_candidates(item, hand_of(model, model.gripper()))
    best = grasps[0]
    assert len(best.contacts) == 2
    over_the_edge = replace(best, T_object_tcp=best.T_object_tcp @ SE3.from_xyz(0.07, 0.0, 0.0))
    firm, leaking = prove_grasps(model, model.gripper(), item, [best, over_the_edge], trials=8)
    assert (firm.successes, leaking.successes) == (8, 0)
    assert firm.slip < 1e-4
    heavy = replace(item, mass=13.0)  # 128 N, more than the cups pull
    (overloaded,) = prove_grasps(model, model.gripper(), heavy, [best], trials=4)
    assert overloaded.successes == 0


def test_prove_grasps_works_in_a_pick():
    with live("sim", settings=replace(OBSERVED, prove_grasps=4, proof_trials=4)) as cell:
        outcome = cell.arm.pick("box")
        assert outcome.ok, outcome.message
        assert outcome.evidence["proof"].successes == 4
