"""`armcell bench ik`: what it prints is what it measured, poses are the seed's, errors are one line."""

from __future__ import annotations

import json

import numpy as np
import pytest
from tests.cli.helpers import call
from tests.kinematics.arms import NAMES, dh_rows
from tests.model.helpers import joint, link, robot


def measured(capsys, tmp_path, *arguments):
    file = tmp_path / "out.json"
    said = call(capsys, "bench", "ik", *arguments, "--json", file)
    return said, json.loads(file.read_text())


def urdf(folder, name: str = "UR5"):
    """A UR by its table, without planning groups."""
    parts, before = [link("base")], "0 0 0"
    turn = "0 0 0"
    for k, (d, a, alpha) in enumerate(dh_rows(name)):
        parent = "base" if k == 0 else f"l{k}"
        origin = f'<origin xyz="{before}" rpy="{turn}"/><axis xyz="0 0 1"/>'
        parts += [link(f"l{k + 1}"), joint(NAMES[k], parent, f"l{k + 1}", inside=origin)]
        before, turn = f"{a!r} 0 {d!r}", f"{float(alpha)!r} 0 0"
    file = folder / "arm.urdf"
    file.write_text(robot(*parts))
    return file


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "method"),
    [(["--robot", "ur10"], "analytic"), (["--robot", "ur10", "--numeric"], "numeric"),
     (["--robot", "panda"], "numeric")],
)  # fmt: skip
def test_every_pose_is_solved_and_told(capsys, tmp_path, arguments, method):
    said, data = measured(capsys, tmp_path, *arguments, "--count", "40")
    summary, rows = data["summary"], data["rows"]
    assert said.status == 0 and "100.0 %" in said.out and method in said.out
    assert summary["method"] == method and summary["poses"] == len(rows) == 40
    assert [row["index"] for row in rows] == list(range(40)) and all(row["solved"] for row in rows)
    for key in ("compiled_us", "call_us"):
        values = [row[key] for row in rows]
        assert min(values) > 0.1
        assert summary[f"{key}_median"] == pytest.approx(np.median(values))
        assert summary[f"{key}_p95"] == pytest.approx(np.percentile(values, 95))
    assert all(c["compiled_us"] < c["call_us"] for c in rows)
    assert all(1 <= row["solutions"] <= (8 if method == "analytic" else 200) for row in rows)
    assert summary["position_error_max_m"] == max(row["position_error_m"] for row in rows) <= 1.1e-6


def test_the_seed_makes_the_poses(capsys, tmp_path):
    counts = []
    for seed in (3, 3, 4):
        _, data = measured(capsys, tmp_path, "--robot", "ur10", "--count", "60", "--seed", seed)
        counts.append([row["solutions"] for row in data["rows"]])
    assert counts[0] == counts[1] != counts[2]


@pytest.mark.slow
def test_a_urdf_without_groups_by_its_tip(capsys, tmp_path):
    said, data = measured(capsys, tmp_path, "--robot", urdf(tmp_path), "--tip", "l6", "--count", "20")
    assert said.status == 0 and data["summary"]["method"] == "analytic"
    said, data = measured(capsys, tmp_path, "--robot", "panda", "--tip", "panda_link4", "--count", "20")
    assert said.status == 0 and data["summary"]["tip"] == "panda_link4"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--robot", "nobody"], "unknown robot 'nobody'"),
        (["--robot", "panda", "--group", "leg"], "unknown planning group 'leg'"),
        (["--robot", "panda", "--tip", "nose"], "unknown link 'nose'"),
        (["--robot", "panda", "--group", "hand"], "'hand' is not a chain"),
        (["--robot", "parallel_gripper"], "0 planning groups with a tip (name the link to place with --tip)"),
        (["--robot", "ur10", "--json", "/nowhere/x.json"], "/nowhere"),
    ],
)
def test_mistakes_are_one_line(capsys, arguments, words):
    said = call(capsys, "bench", "ik", *arguments)
    assert said.status == 1 and words in said.err and said.err.count("\n") == 1 and not said.out


def test_help_teaches(capsys):
    said = call(capsys, "bench", "ik", "--help")
    assert said.status == 0
    for word in (
        "--robot",
        "--group",
        "--tip",
        "--count",
        "--seed",
        "--numeric",
        "--json",
        "Examples",
        "analytic",
    ):
        assert word in said.out
    assert "ik" in call(capsys, "bench", "--help").out
