"""`armcell bench mbm`: problems in, times and paths that touch nothing out."""

from __future__ import annotations

import gzip
import itertools
import json

import numpy as np
import pytest

from armcell.cli.main import main
from armcell.collision import ExactChecker
from armcell.core import SE3, Box
from armcell.model import load_robot
from armcell.scene import CollisionObject, PlanningScene

HOME = [0.0, -1.57, 1.57, -1.57, -1.57, 0.0]
OVER = [1.6, -1.57, 1.57, -1.57, -1.57, 0.0]
WALL = {
    "name": "wall", "type": "box", "position": [0.5, 0.5, 0.5], "quat_xyzw": [0, 0, 0.382683, 0.92388],
    "size": [0.6, 0.05, 1.0],
}  # fmt: skip
POST = {
    "name": "post", "type": "cylinder", "position": [-0.6, 0.0, 0.5], "quat_xyzw": [0, 0, 0, 1],
    "radius": 0.05, "length": 1.0,
}  # fmt: skip


def problems(folder, **changes):
    names = list(load_robot("ur10").joint_names)
    one = {"index": 1, "start": HOME, "goals": [OVER], "obstacles": [WALL, POST]}
    data = {"joints": names, "fixed_joints": {}, "families": {"wall": [one]}, **changes}
    file = folder / "problems.json.gz"
    with gzip.open(file, "wt") as out:
        json.dump(data, out)
    return str(file)


def test_it_times_and_writes_paths_that_touch_nothing(tmp_path):
    out, paths = tmp_path / "out.json", tmp_path / "paths.json.gz"
    status = main(
        ["bench", "mbm", "--problems", problems(tmp_path), "--robot", "ur10", "--repeat", "1",
         "--json", str(out), "--paths", str(paths)]
    )  # fmt: skip
    (row,) = json.loads(out.read_text())
    assert status == 0 and row["solved"] and (row["family"], row["index"]) == ("wall", 1)
    assert all(row[key] > 0 for key in ("plan_us", "simplify_us", "certify_us", "timing_us"))
    straight = np.linalg.norm(np.subtract(OVER, HOME))
    assert straight - 1e-6 <= row["length"] <= row["length_raw"] + 1e-6
    with gzip.open(paths, "rt") as text:
        waypoints = np.array(json.load(text)["wall"]["1"])
    np.testing.assert_allclose(waypoints[[0, -1]], [HOME, OVER], atol=1e-6)
    wall = CollisionObject.single(
        "wall", Box(*WALL["size"]), SE3.from_quat_xyzw(WALL["position"], WALL["quat_xyzw"])
    )
    judge = ExactChecker(PlanningScene.of(load_robot("ur10"), HOME, [wall]))
    for a, b in itertools.pairwise(waypoints):
        for t in np.linspace(0, 1, max(int(np.abs(b - a).max() / 0.002), 2)):
            assert judge.is_free(a + t * (b - a))
    assert not all(judge.is_free(HOME + t * np.subtract(OVER, HOME)) for t in np.linspace(0, 1, 200))


def test_a_goal_in_the_wall_is_not_solved(tmp_path, capsys):
    blocked = {**WALL, "position": [0.0, 0.6, 0.6], "size": [2.0, 0.3, 2.0], "quat_xyzw": [0, 0, 0, 1]}
    one = {"index": 3, "start": HOME, "goals": [OVER], "obstacles": [blocked]}
    file = problems(tmp_path, families={"wall": [one]})
    assert main(["bench", "mbm", "--problems", file, "--robot", "ur10", "--seconds", "0.3"]) == 1
    assert "0/1" in capsys.readouterr().out


@pytest.mark.parametrize("data", [b"not json", b"[]", b"{}"])
def test_a_broken_file_is_one_line(tmp_path, capsys, data):
    file = tmp_path / "p.json"
    file.write_bytes(data)
    assert main(["bench", "mbm", "--problems", str(file), "--robot", "ur10"]) == 1
    said = capsys.readouterr().err
    assert "cannot be read as problems" in said and said.count("\n") == 1
