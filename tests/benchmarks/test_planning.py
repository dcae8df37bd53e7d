"""The planning benchmark on a small robot made here: real planners, real rows, a real report."""

from __future__ import annotations

import gzip
import itertools
import json
import re
import sys
import types

import numpy as np
import pytest
from benchmarks.planning import commands, memory
from benchmarks.planning.__main__ import main
from benchmarks.planning.bars import lines
from benchmarks.planning.peers import VAMP, all_peers
from benchmarks.planning.pinocchio_world import PinocchioWorld
from benchmarks.planning.problems import load
from benchmarks.planning.recheck import first_contact
from benchmarks.planning.report import BEGIN, END
from PIL import Image

from armcell.cli.bench_mbm import scene_of
from armcell.collision import ExactChecker
from armcell.model import load_robot

pytestmark = pytest.mark.slow

LINK = """<link name="{0}"><collision><origin xyz="0.2 0 0"/><geometry><box size="0.38 0.06 0.06"/></geometry>
</collision></link>"""
JOINT = """<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/><origin xyz="{3} 0 0"/>
<axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="9" velocity="2"/></joint>"""
URDF = (
    '<robot name="planar"><link name="base"/>'
    + "".join(LINK.format(name) for name in ("upper", "lower"))
    + JOINT.format("shoulder", "base", "upper", 0)
    + JOINT.format("elbow", "upper", "lower", 0.4)
    + "</robot>"
)
SRDF = '<robot name="planar"><disable_collisions link1="upper" link2="lower" reason="Adjacent"/></robot>'
POST = {"name": "post", "type": "cylinder", "position": [0.7, 0.0, 0.0], "quat_xyzw": [0, 0, 0, 1],
        "radius": 0.05, "length": 1.0}  # fmt: skip
SLAB = {"name": "slab", "type": "box", "position": [0.1, 0.45, 0.0], "quat_xyzw": [0, 0, 0, 1],
        "size": [0.3, 0.05, 0.5]}  # fmt: skip
START, GOAL = [0.6, 0.3], [-0.6, -0.3]


@pytest.fixture
def folder(tmp_path):
    """Problems as MotionBenchMaker's, for a planar arm under the names of two of its robots."""
    problem = {"index": 1, "start": START, "goals": [GOAL], "obstacles": [POST, SLAB]}
    blocked = {**problem, "index": 2, "goals": [[0.0, 0.0]]}  # stretched out, into the post
    for name in ("panda", "ur5"):
        robot = tmp_path / "robots" / name
        robot.mkdir(parents=True)
        (robot / f"{name}.urdf").write_text(URDF)
        (robot / f"{name}.srdf").write_text(SRDF)
        families = {"around": [problem], "into": [blocked]}
        data = {"joints": ["shoulder", "elbow"], "fixed_joints": {}, "families": families}
        with gzip.open(tmp_path / f"mbm_{name}.json.gz", "wt") as out:
            json.dump(data, out)
    return tmp_path


def test_a_quick_run_writes_rows_tables_and_pictures(folder, capsys):
    document, out = folder / "doc.md", folder / "rows.json"
    document.write_text(f"# Before\n{BEGIN}\nstale\n{END}\nafter\n")
    run = ["--quick", "--mbm", str(folder), "--document", str(document), "--json", str(out)]
    assert main(run) == 0
    rows = json.loads(out.read_text())["rows"]
    planned = [r for r in rows if r["family"] == "around"]
    assert {r["robot"] for r in planned} == {"panda", "ur5"} and len(planned) in (6, 8)
    assert all(r["solved"] and r["plan_us"] > 0 for r in planned)
    straight = np.linalg.norm(np.subtract(GOAL, START))
    assert all(straight < r["length"] <= r["length_raw"] + 1e-6 for r in planned)
    assert all("obstacle 0" in r["touching"] and not r["solved"] for r in rows if r["family"] == "into")
    assert all(r["contact"] == "" for r in rows if r["planner"] == "armcell" and r["solved"])

    text = document.read_text()
    assert text.startswith("# Before\n") and text.endswith("after\n") and "stale" not in text
    (mine,) = (r for r in planned if r["planner"] == "armcell" and r["robot"] == "panda")
    (cells,) = re.findall(r"^\| armcell \|(.*)\|$", text.split("### UR5")[0], re.MULTILINE)
    cells = [cell.strip() for cell in cells.split("|")]
    assert cells[0] == "1/1" and cells[5] == f"{mine['length']:.2f} rad" and cells[6] == "0 of 1"
    assert cells[1] == cells[2] and cells[1].split()[1] in ("us", "ms")
    for name in re.findall(r"\((pictures/.*\.png)\)", text):
        picture = folder / name
        assert picture.stat().st_size < 200_000 and Image.open(picture).size[0] > 500
    said = capsys.readouterr().out
    assert re.search(r"mean length +5\.2 rad +\d\.\d\d rad +hit", said)
    assert "no baxter problems in this run" in said


def test_without_problems_the_lines_say_where_they_are_expected(tmp_path, capsys):
    out = tmp_path / "rows.json"
    assert main(["--quick", "--mbm", str(tmp_path / "none"), "--json", str(out)]) == 0
    said = capsys.readouterr()
    assert "MBM=/path" in said.err
    verdicts = [line.verdict for line in lines(json.loads(out.read_text()))]
    assert all(verdict.startswith("skipped: ") for verdict in verdicts)
    assert sum("MBM=/path" in verdict for verdict in verdicts) == 12


@pytest.mark.parametrize("module", [None, types.ModuleType("vamp")])  # none, and the audio package
def test_vamp_is_left_out_where_its_import_fails(module, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "vamp", module)
    monkeypatch.delitem(sys.modules, "benchmarks.planning.peers.vamp", raising=False)
    assert VAMP not in [peer.name for peer in all_peers()]
    assert "Leaving out VAMP: " in capsys.readouterr().err


def test_the_comparison_with_vamp_uses_the_problems_that_both_solved():
    def row(planner, index, ms, solved=True):
        return {"robot": "ur5", "planner": planner, "family": "f", "index": index, "solved": solved,
                "plan_us": 1000.0 * ms, "simplify_us": 0.0, "certify_us": 0.0, "length": 1.0}  # fmt: skip

    def judged(*rows):
        results = {"rows": rows, "problems": {"ur5": {"begun": 3, "all": 3}}}
        (line,) = (line for line in lines(results) if line.what.startswith("ur5") and "VAMP" in line.what)
        return line

    ours = [row("armcell", i, ms) for i, ms in ((1, 3.0), (2, 3.0), (3, 90.0))]
    theirs = [row("VAMP", 1, 2.0), row("VAMP", 2, 2.0), row("VAMP", 3, 0.0, solved=False)]
    line = judged(*ours, *theirs)
    assert line.verdict == "hit"
    assert line.measured == "1.50 / 1.50 (3 ms / 3 ms; VAMP 2 ms / 2 ms; 2 problems)"
    assert judged(*ours, row("VAMP", 3, 20.0)).verdict == "MISSED"
    assert judged(*ours).verdict == "skipped: VAMP is not installed"


@pytest.mark.long
def test_memory_with_a_cloud():
    found = memory.measure()
    assert found["points"] == 200_000 and 0 < found["mb"] <= 300 and found["build_ms"] < 1000
    assert found["solved"] == found["tasks"] > 20


def test_the_second_look_agrees_with_the_exact_checker(folder):
    """pinocchio and coal against armcell's own, on configurations and on a path through the post."""
    robot, problems = load(folder, "panda")
    world = PinocchioWorld(robot)
    world.set_problem(problems[0])
    model = load_robot(robot.urdf)
    judge = ExactChecker(scene_of(model, {}, {"obstacles": problems[0].obstacles}), robot.joints)
    samples = np.random.default_rng(0).uniform(-2.5, 2.5, (300, 2))
    touches = [world.touches(q) for q in samples]
    assert touches == [not judge.is_free(q) for q in samples] and 0.05 < np.mean(touches) < 0.95

    through = np.array([START, GOAL])
    assert "obstacle 0" in first_contact(world, through)
    around = np.array([START, [0.6, 2.3], [-0.6, 2.3], [-0.6, -0.3]])
    free = all(
        judge.is_free(a + t * (b - a)) for a, b in itertools.pairwise(around) for t in np.linspace(0, 1, 500)
    )
    assert (first_contact(world, around) == "") == free


def test_a_command_that_does_not_exist_is_missing():
    with pytest.raises(commands.Missing, match="`armcell bench nosuch` does not exist"):
        commands.bench("nosuch")
