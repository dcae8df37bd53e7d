"""The built-in cell `suction_pick`: four objects placed by cups, two refused before the arm moves."""

from __future__ import annotations

import numpy as np
import pytest
from tests.sizes import sizes

import armcell
from armcell.cell import run_task
from armcell.cell.gripper_proof import prove_gripper

PLACES = {"carton": (-0.08, 0.09), "plate": (0.09, 0.09), "box": (-0.1, -0.1), "can": (0.09, -0.1)}


def run(mode: str, seed: int) -> tuple[dict, dict[str, float]]:
    """The result, and the distance [m] of each object from its place on the mat."""
    cell = armcell.load("suction_pick")
    mat = cell.scene().object("mat").T_world_object.translation[:2]
    with cell.connect(mode, seed=seed) as live:
        result = run_task(cell, live, seed, mode)
        poses = live.driver.object_poses()
    away = {n: float(np.linalg.norm(poses[n].translation[:2] - mat - at)) for n, at in PLACES.items()}
    return result, away


@pytest.mark.long
@pytest.mark.parametrize("mode", ("sim", "fake"))
def test_the_cell_places_four_objects_and_refuses_two(mode):
    result, away = run(mode, 0)
    assert result["success"], result["message"]
    assert result["unwanted_contacts"] == [] and result["welds"] == [] and result["lost"] == []
    assert max(away.values()) < 5e-3
    assert result["max_stage_slip_m"] < 5e-4
    refused = result["measures"]
    assert (
        "needs 205 N, 2 times the load of 102 N; the vacuum of 2 cups pulls 122 N" in refused["refused_safe"]
    )
    assert (
        "leaks: the surface reaches" in refused["refused_ball"] and "into the cup" in refused["refused_ball"]
    )


@pytest.mark.long
@pytest.mark.parametrize("seeds", sizes(3, 20))
def test_nearly_every_seed_succeeds(seeds):
    results = [run("sim", seed) for seed in range(seeds)]
    good = [r["success"] and max(away.values()) < 5e-3 for r, away in results]
    failed = [r["message"] for (r, _), ok in zip(results, good, strict=True) if not ok]
    assert len(failed) <= 0.05 * seeds, failed
    assert all(r["unwanted_contacts"] == [] and r["welds"] == [] for r, _ in results)


def test_the_gripper_is_proven_on_a_plate():
    model = armcell.load_robot("ur10_suction")
    proof = prove_gripper(model, model.gripper())
    assert proof.held and proof.slip < 1e-3
    assert "holds a plate of 116 mm" in proof.text
