"""`armcell bench grasp`: rows that can be checked, and what is said of bad folders."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from tests.cli.helpers import call, read_json

from armcell.cell.grasp_benchmark import ObjectResult, objects_of, summary
from armcell.cell.grasp_predictions import HoldResult, Prediction
from armcell.core import InputError
from armcell.model import load_robot
from armcell.scene import PlanningScene
from armcell.scene.objects import DEFAULT_DENSITY
from armcell.sim import SimWorld


@pytest.mark.slow
def test_a_mesh_of_a_folder_is_picked_and_placed(capsys, tmp_path):
    (tmp_path / "parts").mkdir()
    trimesh.creation.box((90, 50, 60)).export(tmp_path / "parts" / "block.stl")
    trimesh.creation.torus(45, 12).export(tmp_path / "parts" / "ring.ply")
    (tmp_path / "parts" / "broken.obj").write_text("v 0 0 0\nv nan 0 1\nv 0 1 0\nf 1 2 3\n")
    said = call(capsys, "bench", "grasp", "--no-library", "--objects", tmp_path / "parts", "--scale", "0.001",
                "--candidates", "4", "--proof-trials", "3", "--predictions", "2",
                "--json", tmp_path / "out.json")  # fmt: skip
    found = read_json(tmp_path / "out.json")
    block, broken, ring = found["rows"]
    assert said.status == 0 and [block["name"], broken["name"], ring["name"]] == ["block", "broken", "ring"]
    assert not broken["graspable"] and "broken.obj" in broken["reason"]
    for row in (block, ring):
        assert row["success"] and row["error_m"] < 0.01 and row["slip_m"] < 0.01
        assert row["probability"] > 0.5 and row["generation_s"] > 0
        assert [p["success"] for p in row["predictions"]] == [True, True]
        assert all(p["held"]["slip_m"] < 0.008 for p in row["predictions"])
    assert found["summary"]["first_attempt"] == {
        "successes": 2, "trials": 2, "share": 1.0, "low": pytest.approx(0.3424, abs=1e-4), "high": 1.0
    }  # fmt: skip
    assert "first attempt: 100.0 % (2 of 2" in said.words
    assert "with recovery: 100.0 % (2 of 2" in said.words
    assert found["summary"]["predictions"] == 4 and sum(b["n"] for b in found["summary"]["reliability"]) == 4
    assert "of 4 predictions" in said.words and "0 failures" in said.words


def _predicted(probability: float, epsilon: float, success: bool) -> Prediction:
    return Prediction("a grasp", probability, epsilon, success, HoldResult(success, 0.0, 0.0))


def test_the_summary_counts_what_cannot_be_gripped_apart():
    rows = [
        ObjectResult(
            "a", 1.0, True, success=True, predictions=[_predicted(0.9, 0.1, True), _predicted(0.7, 0.1, True)]
        ),
        ObjectResult(
            "b", 1.0, True, success=False, recovered=True, predictions=[_predicted(0.2, 0.05, False)]
        ),
        ObjectResult("c", 1.0, False, "too wide"),
    ]
    found = summary(rows)
    assert (found["objects"], found["graspable"]) == (3, 2)
    assert found["first_attempt"]["share"] == 0.5 and found["with_recovery"]["share"] == 1.0
    assert found["brier_proof"] == pytest.approx(np.mean([0.1**2, 0.3**2, 0.2**2]))
    assert found["brier_base_rate"] == pytest.approx(1.0)  # each object is predicted by the other
    assert "with_recovery" not in summary(rows, recovery=False)


def test_an_object_without_inertia_weighs_what_its_solid_does(tmp_path):
    trimesh.creation.box((0.04, 0.04, 0.04)).export(tmp_path / "cube.stl")
    mesh = '<geometry><mesh filename="cube.stl"/></geometry>'
    text = f'<robot name="r"><link name="a"><collision>{mesh}</collision></link></robot>'
    (tmp_path / "cube.urdf").write_text(text)
    ((_, item, _),) = objects_of(tmp_path, load_robot("panda").gripper(), 1)
    mass = DEFAULT_DENSITY * 0.04**3
    assert item.mass_kg == pytest.approx(mass)
    model = SimWorld(PlanningScene.of(load_robot("panda"), objects=[item])).mj_model
    body = model.body("cube")
    assert float(body.mass[0]) == pytest.approx(mass, rel=1e-3)
    np.testing.assert_allclose(body.inertia, mass * 0.04**2 / 6, rtol=1e-2)


def test_the_first_files_are_left_out(tmp_path):
    for name in "abc":
        trimesh.creation.box((0.05, 0.04, 0.03)).export(tmp_path / f"{name}.stl")
    gripper = load_robot("panda").gripper()
    assert [name for name, _, _ in objects_of(tmp_path, gripper, 1, skip=1)] == ["b"]
    assert [name for name, _, _ in objects_of(tmp_path, gripper, 9, skip=1)] == ["b", "c"]
    with pytest.raises(InputError, match="has 3 files, 3 are to be skipped"):
        list(objects_of(tmp_path, gripper, 1, skip=3))


@pytest.mark.parametrize(
    "name, says", [("nowhere", "is not a folder"), ("empty", "has no mesh and no URDF in it")]
)
def test_bad_folders(name, says, capsys, tmp_path):
    (tmp_path / "empty").mkdir()
    said = call(capsys, "bench", "grasp", "--no-library", "--objects", tmp_path / name)
    assert said.status == 1 and says in said.err


def test_a_mesh_in_millimeters_names_the_cure(capsys, tmp_path):
    trimesh.creation.box((120, 50, 9000)).export(tmp_path / "block.stl")
    said = call(capsys, "bench", "grasp", "--no-library", "--objects", tmp_path)
    assert said.status == 1 and "block.stl" in said.err and "scale: 0.001" in said.err
