"""A robot goes by what is believed, physics by what is true; what a proof says of a grasp comes about."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from armcell.cell import grasp_predictions
from armcell.cell.grasp_predictions import HoldResult, predictions, simulate_pick
from armcell.core import SE3, Box
from armcell.grasping import grasp_candidates, hand_of
from armcell.model import load_robot
from armcell.scene import CollisionObject, Material, PlanningScene, mesh_object
from armcell.tasks import TaskSettings, distinct_grasps, prove_grasps, sample_object_variants

MODEL = load_robot("panda")
GRIPPER = MODEL.gripper()
SETTINGS = TaskSettings(lift_distance=0.2, proof_trials=8, planning_budget=600.0)
TABLE = CollisionObject.single("table", Box(1.0, 1.4, 0.04), SE3.from_xyz(0.5, 0.0, -0.021))


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("ARMCELL_CACHE_DIR", str(tmp_path))


def on_table(item: CollisionObject) -> PlanningScene:
    return PlanningScene.of(MODEL, objects=[TABLE]).with_padding(0.003).with_object(item)


@pytest.fixture(scope="module")
def cube():
    item = CollisionObject.single("cube", Box(0.05, 0.05, 0.05), SE3.from_xyz(0.5, -0.1, 0.024), movable=True)
    item = replace(item, mass=0.2, material=Material(0.5))
    return item, on_table(item), grasp_candidates(item, hand_of(MODEL, GRIPPER))[0]


@pytest.fixture(scope="module")
def pebble(tmp_path_factory):
    """A flat ellipsoid, which slides out of a hand that holds it beside its middle."""
    mesh = trimesh.creation.icosphere(3)
    mesh.apply_transform(np.diag([0.06, 0.03, 0.02, 1.0]))
    file = tmp_path_factory.mktemp("pebble") / "pebble.stl"
    mesh.export(file)
    item = mesh_object("pebble", file, SE3.from_xyz(0.5, -0.15, 0.019))
    item = replace(item, material=Material(0.5))
    return item, on_table(item), grasp_candidates(item, hand_of(MODEL, GRIPPER))[0]


@pytest.mark.long
def test_the_robot_goes_where_the_object_is_believed_to_be(cube):
    item, scene, grasps = cube
    as_believed = simulate_pick(scene, item, GRIPPER, grasps[0], SETTINGS, 0.5)
    assert as_believed is not None and as_believed.firmly and as_believed.slip_m < 1e-3
    elsewhere = item.at(item.T_world_object.shifted(-0.15, 0.0, 0.0))
    missed = simulate_pick(scene, elsewhere, GRIPPER, grasps[0], SETTINGS, 0.5)
    assert missed is not None and not missed.to_the_end and not missed.firmly
    assert "nothing is between the fingers" in missed.reason


def test_what_is_planned_with_is_what_is_believed(cube, monkeypatch):
    item, scene, grasps = cube
    truth = sample_object_variants(item, 2, np.random.default_rng(3))[1]
    known = []

    def spied(ctx, stages, what):
        known.append(ctx.scene().object("cube"))
        return grasp_predictions_planned(ctx, stages, what)

    grasp_predictions_planned = grasp_predictions.plan_stages
    monkeypatch.setattr(grasp_predictions, "plan_stages", spied)
    held = simulate_pick(scene, truth, GRIPPER, grasps[0], SETTINGS, 0.5)
    assert held is not None and held.firmly
    assert known[0].T_world_object.distance_to(item.T_world_object) == (0.0, 0.0)
    assert (known[0].material, known[0].mass) == (item.material, item.mass)
    assert truth.T_world_object.distance_to(item.T_world_object)[0] > 1e-4


@pytest.mark.slow
def test_physics_has_the_true_friction_and_mass(cube):
    item, scene, grasps = cube
    for truth in (replace(item, material=Material(0.05)), replace(item, mass=5.0)):
        held = simulate_pick(scene, truth, GRIPPER, grasps[0], SETTINGS, 0.5)
        assert held is not None and not held.firmly


@pytest.mark.long
def test_a_poor_grasp_gets_a_low_p_and_fails_where_a_good_one_holds(pebble):
    item, scene, grasps = pebble
    proofs = prove_grasps(MODEL, GRIPPER, item, distinct_grasps(grasps, 40), SETTINGS.proof_trials)
    poor = min(proofs, key=lambda p: p.probability)
    good = next(p for p in proofs if p.successes == p.trials)
    assert poor.probability < 0.3 and good.probability > 0.95
    truths = sample_object_variants(item, 5, np.random.default_rng(5))[1:]

    def successes(grasp):
        found = [simulate_pick(scene, truth, GRIPPER, grasp, SETTINGS, 1.0) for truth in truths]
        return sum(held is not None and held.firmly for held in found)

    assert successes(poor.grasp) <= 1 and successes(good.grasp) == len(truths)


@pytest.mark.slow
def test_grasps_are_drawn_anew_with_another_seed_and_keep_their_proofs(cube):
    item, scene, grasps = cube
    ask = lambda *seed: predictions(scene, item, GRIPPER, grasps, SETTINGS, 2, 0.2, seed)  # noqa: E731
    first, again, other = ask(0, 1), ask(0, 1), ask(0, 2)
    assert first == again and len(first) == len(other) == 2
    assert [p.held for p in first] != [p.held for p in other]
    by_name = {g.name: g for g in grasps}
    for found in first:
        (proof,) = prove_grasps(MODEL, GRIPPER, item, [by_name[found.grasp]], SETTINGS.proof_trials)
        assert found.probability == proof.probability and found.success == found.held.firmly


@pytest.mark.parametrize(
    ("held", "firmly"),
    [
        (HoldResult(True, 0.0079, 0.29), True),
        (HoldResult(True, 0.0081, 0.0), False),
        (HoldResult(True, 0.0, 0.31), False),
        (HoldResult(False, 0.0, 0.0), False),
        (HoldResult(True), False),
    ],
)
def test_held_firmly_is_what_a_proof_counts(held, firmly):
    assert held.firmly == firmly
