"""`armcell bench mbm`: problems in, times and paths that touch nothing out."""

from __future__ import annotations

import gzip
import itertools
import json
import os
from pathlib import Path

import numpy as np
import pytest

from armcell.cli.bench_dual import dual_scene
from armcell.cli.bench_mbm import find_robot, read_problems, scene_of
from armcell.cli.main import main
from armcell.collision import ExactChecker
from armcell.core import SE3, Box, InputError
from armcell.model import load_robot
from armcell.scene import CollisionObject, PlanningScene

MBM = Path(os.environ.get("MBM") or Path(__file__).parents[3] / "shared" / "data" / "mbm")
FIELDS = (
    "certify_us", "family", "index", "length", "length_raw", "plan_us", "simplify_us", "solved", "timing_us"
)  # fmt: skip
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


def wall_scene(wall):
    pose = SE3.from_quat_xyzw(wall["position"], wall["quat_xyzw"])
    return PlanningScene.of(
        load_robot("ur10"), HOME, [CollisionObject.single("wall", Box(*wall["size"]), pose)]
    )


def judged_free(waypoints, scene, names=None):
    """Free at samples 2 mrad apart, by the exact checker."""
    judge = ExactChecker(scene, names)
    for a, b in itertools.pairwise(waypoints):
        for t in np.linspace(0, 1, max(int(np.abs(b - a).max() / 0.002), 2)):
            assert judge.is_free(a + t * (b - a))


def test_it_times_and_writes_paths_that_touch_nothing(tmp_path):
    out, paths = tmp_path / "out.json", tmp_path / "paths.json.gz"
    status = main(
        ["bench", "mbm", "--problems", problems(tmp_path), "--robot", "ur10", "--repeat", "1",
         "--json", str(out), "--paths", str(paths)]
    )  # fmt: skip
    (row,) = json.loads(out.read_text())
    assert status == 0 and row["solved"] and (row["family"], row["index"]) == ("wall", 1)
    assert all(row[key] > 0 for key in ("plan_us", "simplify_us", "timing_us"))
    assert row["certify_us"] == 0  # the native planner proves each edge as it shortens
    straight = np.linalg.norm(np.subtract(OVER, HOME))
    assert straight - 1e-6 <= row["length"] <= row["length_raw"] + 1e-6
    with gzip.open(paths, "rt") as text:
        waypoints = np.array(json.load(text)["wall"]["1"])
    np.testing.assert_allclose(waypoints[[0, -1]], [HOME, OVER], atol=1e-6)
    judged_free(waypoints, wall_scene(WALL))
    judge = ExactChecker(wall_scene(WALL))
    assert not all(judge.is_free(HOME + t * np.subtract(OVER, HOME)) for t in np.linspace(0, 1, 200))


@pytest.mark.slow
def test_an_unreachable_goal_is_not_solved(tmp_path, capsys):
    """A peg between a sliding finger and its free goal."""
    peg = {**WALL, "position": [0.0, 0.03, 0.12], "size": [0.004] * 3, "quat_xyzw": [0, 0, 0, 1]}
    one = {"index": 3, "start": [0.0], "goals": [[0.05]], "obstacles": [peg]}
    file = problems(tmp_path, joints=["gripper_left_finger_joint"], families={"peg": [one]})
    options = ["--problems", file, "--robot", "parallel_gripper", "--seconds", "0.3"]
    assert main(["bench", "mbm", *options]) == 1
    said = capsys.readouterr()
    assert "0/1" in said.out and "peg 3: not solved" in said.err


@pytest.mark.parametrize("data", [b"not json", b"[]", b"{}"])
def test_a_broken_file_is_one_line(tmp_path, capsys, data):
    file = tmp_path / "p.json"
    file.write_bytes(data)
    assert main(["bench", "mbm", "--problems", str(file), "--robot", "ur10"]) == 1
    said = capsys.readouterr().err
    assert "cannot be read as problems" in said and said.count("\n") == 1


def test_a_problem_with_a_missing_field_names_it(tmp_path, capsys):
    file = problems(tmp_path, families={"wall": [{"index": 1, "start": HOME, "obstacles": []}]})
    assert main(["bench", "mbm", "--problems", file, "--robot", "ur10"]) == 1
    assert "families/wall[0]: KeyError: 'goals'" in capsys.readouterr().err


def test_an_unknown_planner_names_the_known_ones(tmp_path, capsys):
    file = problems(tmp_path)
    assert main(["bench", "mbm", "--problems", file, "--robot", "ur10", "--planner", "ompl/RRTConect"]) == 1
    assert "did you mean 'RRTConnect'" in capsys.readouterr().err


def test_a_touching_goal_is_counted_apart(tmp_path, capsys):
    around = {**WALL, "position": [0.0, 0.69, 0.6], "size": [2.0, 0.3, 2.0], "quat_xyzw": [0, 0, 0, 1]}
    one = {"index": 5, "start": HOME, "goals": [OVER], "obstacles": [around]}
    assert not ExactChecker(wall_scene(around)).is_free(OVER)
    file, out = problems(tmp_path, families={"wall": [one]}), tmp_path / "out.json"
    assert main(["bench", "mbm", "--problems", file, "--robot", "ur10", "--json", str(out)]) == 0
    (row,) = json.loads(out.read_text())
    assert row["touching"].startswith("goal: ") and "0_wall" in row["touching"]
    assert not row["solved"] and row["plan_us"] is None
    assert "0/0" in capsys.readouterr().out


def test_a_planner_by_name_is_proven_as_well(tmp_path):
    out, paths = tmp_path / "out.json", tmp_path / "paths.json.gz"
    status = main(
        ["bench", "mbm", "--problems", problems(tmp_path), "--robot", "ur10", "--repeat", "1",
         "--planner", "ompl/RRTConnect", "--json", str(out), "--paths", str(paths)]
    )  # fmt: skip
    (row,) = json.loads(out.read_text())
    assert status == 0 and row["solved"] and row["plan_us"] > 0
    assert row["length"] <= row["length_raw"] + 1e-6
    with gzip.open(paths, "rt") as text:
        judged_free(np.array(json.load(text)["wall"]["1"]), wall_scene(WALL))


def test_the_robots_folder_beside_the_problems_is_found_by_name(tmp_path):
    file = Path(problems(tmp_path))
    folder = tmp_path / "robots" / "mine"
    folder.mkdir(parents=True)
    for name in ("mine.urdf", "other.urdf"):
        (folder / name).write_text("<robot name='r'/>")
    assert find_robot("mine", file) == folder / "mine.urdf"
    assert find_robot("ur10", file) == "ur10"
    (folder / "mine.urdf").rename(folder / "third.urdf")
    with pytest.raises(InputError, match="has 2 URDF files"):
        find_robot("mine", file)


needs_mbm = pytest.mark.skipif(not MBM.is_dir(), reason=f"the problems are expected in {MBM}")


@needs_mbm
@pytest.mark.slow
@pytest.mark.cases("native")
@pytest.mark.parametrize("planner", ["native", "ompl/RRTConnect"])
def test_public_problems(tmp_path, planner):
    """Two problems of each family; every row has the same fields and every path is free."""
    file, out, paths = MBM / "mbm_panda.json.gz", tmp_path / "out.json", tmp_path / "paths.json.gz"
    status = main(
        ["bench", "mbm", "--problems", str(file), "--robot", "panda", "--limit", "2", "--repeat", "1",
         "--planner", planner, "--json", str(out), "--paths", str(paths)]
    )  # fmt: skip
    rows, data = json.loads(out.read_text()), read_problems(file)
    assert status == 0 and len(rows) == 14
    assert {tuple(sorted(row)) for row in rows} == {FIELDS}
    model = load_robot(find_robot("panda", file))
    with gzip.open(paths, "rt") as text:
        found = json.load(text)
    for family, some in data["families"].items():
        waypoints = np.array(found[family][str(some[0]["index"])])
        np.testing.assert_allclose(waypoints[[0, -1]], [some[0]["start"], some[0]["goals"][0]], atol=1e-6)
        judged_free(waypoints, scene_of(model, data["fixed_joints"], some[0]), data["joints"])


@needs_mbm
@pytest.mark.long
def test_both_arms_of_a_baxter(tmp_path):
    """Fourteen joints; goals in which a finger touches the shelf are said, and the rest can be planned."""
    file, out = MBM / "mbm_baxter.json.gz", tmp_path / "out.json"
    main(
        ["bench", "mbm", "--problems", str(file), "--robot", str(MBM / "robots" / "baxter"), "--limit", "3",
         "--repeat", "1", "--seconds", "2", "--json", str(out)]
    )  # fmt: skip
    rows = json.loads(out.read_text())
    data = read_problems(file)
    model = load_robot(find_robot("baxter", file))
    assert len(rows) == 9
    for row in rows:
        (problem,) = (p for p in data["families"][row["family"]] if p["index"] == row["index"])
        judge = ExactChecker(scene_of(model, data["fixed_joints"], problem), data["joints"])
        free = judge.is_free(problem["start"]) and judge.is_free(problem["goals"][0])
        assert ("touching" in row) == (not free)
    assert any(row["solved"] for row in rows) and any("touching" in row for row in rows)


@pytest.mark.long
def test_two_arms_are_planned_as_one(tmp_path):
    """The generated problems are the same for the same seed, and their paths touch nothing."""

    def run(seed, name):
        out, paths = tmp_path / f"{name}.json", tmp_path / f"{name}.json.gz"
        main(["bench", "dual", "--count", "2", "--repeat", "1", "--seed", str(seed),
              "--json", str(out), "--paths", str(paths)])  # fmt: skip
        with gzip.open(paths, "rt") as text:
            return json.loads(out.read_text()), json.load(text)["uniform"]

    rows, found = run(1, "a")
    assert [row["solved"] for row in rows] == [True, True] and {tuple(sorted(r)) for r in rows} == {FIELDS}
    assert run(1, "b")[1] == found != run(2, "c")[1]
    scene = dual_scene()
    assert len(scene.attached) == 2
    arms = [f"{side}_arm" for side in ("left", "right")]
    names = [name for arm in arms for name in scene.model.group(arm).joint_names]
    for waypoints in found.values():
        judged_free(np.array(waypoints), scene, names)
