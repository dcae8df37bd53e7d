"""`check` and `explain`: sound and unsound cells, reachable and other poses, and the evidence as JSON."""

from __future__ import annotations

import pytest
from tests.cli.helpers import call, cell_file, read_json

from armcell.cell import cell_names

TABLE = "  table: {box: [1, 1, 0.1], pose: [0.5, 0, -0.051]}\n"


def cell_with(cube: str, more: str = "", task: str = "task: [{pick: cube}]\n") -> str:
    return (
        f"robot: panda\nstart: {{arm: home, hand: open}}\nobjects:\n{TABLE}  cube: {{{cube}}}\n{more}{task}"
    )


GOOD = "box: [0.05, 0.05, 0.05], pose: [0.5, 0, 0.024], movable: true"


@pytest.mark.slow
@pytest.mark.cases(
    "panda_pick", "dual_ur10_rod", "suction_pick", "bin_clearing", "conveyor_pick", "six_axis_camera"
)
@pytest.mark.parametrize("name", cell_names())
def test_the_built_in_cells_are_sound(capsys, tmp_path, name):
    said = call(capsys, "check", name, "--json", tmp_path / "found.json")
    assert said.status == 0
    findings = read_json(tmp_path / "found.json")
    assert all(f["ok"] for f in findings)
    looked_at = {f["check"] for f in findings}
    assert {"cell file", "robot", "start state"} <= looked_at
    if name.startswith(("three", "four", "suction", "panda_ur10e")):
        assert any(check.startswith("object ") for check in looked_at)
    elif not name.startswith(("dual", "bin", "conveyor", "six_axis_sort")):
        item = "object" if name == "six_axis_table" else "cube"
        assert {f"object {item}", f"pick {item}"} <= looked_at


# cell, what was looked at, what was found
UNSOUND = {
    "start in collision": (cell_with(GOOD, "  beam: {box: [0.4, 0.4, 0.1], pose: [0.3, 0, 0.6]}\n"),
                           "start state", "touches beam"),
    "sunk": (cell_with("box: [0.05, 0.05, 0.05], pose: [0.5, 0, 0.01], movable: true"),
             "object cube", "14.0 mm inside table"),
    "too wide": (cell_with("box: [0.15, 0.15, 0.15], pose: [0.5, 0, 0.074], movable: true"),
                 "pick cube", "the gripper opens 80 mm"),
    "too far": (cell_with("box: [0.05, 0.05, 0.05], pose: [3, 0, 0.024], movable: true"),
                "pick cube", "out of reach"),
    "fixed": (cell_with("box: [0.05, 0.05, 0.05], pose: [0.5, 0, 0.024]"), "pick cube", "movable: true"),
    "no room for it": (
        cell_with(GOOD, "  post: {cylinder: [0.005, 0.2], pose: [0.4, 0.3, 0.1]}\n",
                  "task: [{pick: cube}, {place: {object: cube, on: post}}]\n"), "place cube", "does not fit"),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("text", "looked_at", "found"), UNSOUND.values(), ids=UNSOUND)
def test_an_unsound_cell_is_status_1_with_the_reason(capsys, tmp_path, text, looked_at, found):
    said = call(capsys, "check", cell_file(tmp_path, text), "--json", tmp_path / "found.json")
    assert said.status == 1
    wrong = {f["check"]: f["found"] for f in read_json(tmp_path / "found.json") if not f["ok"]}
    assert found in wrong[looked_at]
    assert found in said.words


@pytest.mark.slow
def test_several_things_wrong_are_all_told(capsys, tmp_path):
    text = cell_with(
        "box: [0.15, 0.15, 0.15], pose: [0.5, 0, 0.05], movable: true",
        "  beam: {box: [0.4, 0.4, 0.1], pose: [0.3, 0, 0.6]}\n",
    )
    call(capsys, "check", cell_file(tmp_path, text), "--json", tmp_path / "found.json")
    wrong = {f["check"] for f in read_json(tmp_path / "found.json") if not f["ok"]}
    assert wrong == {"start state", "object cube", "pick cube"}


def test_nothing_is_cut_off_in_a_pipe(capsys, tmp_path):
    folder = tmp_path / ("a_folder_with_quite_a_long_name_" * 3)
    folder.mkdir()
    said = call(capsys, "check", cell_file(folder, cell_with(GOOD)))
    assert "".join(said.out.split()).find("cell.yaml") > 0


# --- explain ---
POSES = {
    "free": (("0.5", "-0.2", "0.4"), True, "joint solutions are free"),
    "too far": (("3", "0", "0.5"), False, "cannot reach the pose"),
    "in the wall": (("0.55", "0.06", "0.2"), False, "wall"),
}


@pytest.mark.slow
@pytest.mark.parametrize(("pose", "reachable", "reason"), POSES.values(), ids=POSES)
def test_explain_a_pose(capsys, tmp_path, pose, reachable, reason):
    said = call(capsys, "explain", "panda_pick", "--pose", *pose, "--json", tmp_path / "why.json")
    assert said.status == (0 if reachable else 1)
    assert reason in said.words
    evidence = read_json(tmp_path / "why.json")
    assert evidence["reachable"] is reachable and reason in evidence["summary"]
    branches = evidence["branches"]
    assert any(not b["contacts"] for b in branches) is reachable
    assert all(len(b["positions"]) == len(evidence["joint_names"]) for b in branches)
    if reason == "wall":
        assert branches and all(
            any("wall" in (c["body_a"], c["body_b"]) and c["distance_m"] < 0 for c in b["contacts"])
            for b in branches
        )
    if not branches:
        assert evidence["position_error_m"] > 1.5


@pytest.mark.slow
def test_explain_the_orientation_counts(capsys):
    """Pointing up, 5 cm above the table, the hand would be in the table."""
    pose = ("--pose", "0.45", "-0.4", "0.05")
    assert call(capsys, "explain", "panda_pick", *pose).status == 0
    assert call(capsys, "explain", "panda_pick", *pose, "--rpy-deg", "0", "0", "0").status == 1


@pytest.mark.slow
def test_explain_a_pick(capsys, tmp_path):
    said = call(capsys, "explain", "panda_pick", "--pick", "cube", "--json", tmp_path / "why.json")
    assert said.status == 0
    evidence = read_json(tmp_path / "why.json")
    assert evidence["works"] and all(name.startswith(("top", "slanting")) for name in evidence["works"])
    assert not set(evidence["works"]) & set(evidence["rejected"])
    assert any("what the object stands on" in reason for reason in evidence["rejected"].values())
    for name in evidence["works"]:
        assert name in said.words


def test_explain_a_pick_that_cannot_be(capsys, tmp_path):
    text = cell_with("box: [0.15, 0.15, 0.15], pose: [0.5, 0, 0.074], movable: true")
    said = call(capsys, "explain", cell_file(tmp_path, text), "--pick", "cube")
    assert said.status == 1
    assert "150 mm wide, the gripper opens 80 mm" in said.words and "0 of" in said.words


def test_explain_a_pick_of_a_fixed_object(capsys):
    said = call(capsys, "explain", "panda_pick", "--pick", "table")
    assert said.status == 1 and "fixed" in said.out + said.err


@pytest.mark.slow
def test_explain_another_draw(capsys, tmp_path):
    for seed in (0, 1):
        call(
            capsys, "explain", "panda_pick", "--pick", "cube", "--seed", seed, "--json", tmp_path / f"{seed}"
        )
    assert read_json(tmp_path / "0") != read_json(tmp_path / "1")


@pytest.mark.parametrize("command", [("check",), ("explain", "--pick", "cube")])
def test_json_that_cannot_be_written_is_said_before(capsys, tmp_path, command):
    said = call(capsys, command[0], "panda_pick", *command[1:], "--json", tmp_path / "none" / "x.json")
    assert said.status == 1 and said.out == ""
    assert "folder does not exist" in said.err
