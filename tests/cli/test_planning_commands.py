"""plan, ik, fk, check-state: numbers that agree with the library, reasons, and exit status 0, 1, 2."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from tests.cli.helpers import call, cell_file, read_json

from armcell.cell import load
from armcell.collision import ExactChecker
from armcell.core import JointState

HOME_DEG = "0 -45 0 -135 0 90 45"


@pytest.fixture(scope="module")
def scene():
    return load("panda_pick").scene()


# --- plan ---
GOALS = {
    "named": ("--to", "extended"),
    "pose": ("--pose", "0.5", "0.2", "0.3"),
    "joints in degrees": ("--joints-deg", "panda_joint1=30 panda_joint4=-120"),
    "joints in radians": ("--joints", "0.1,-0.7,0,-2.2,0,1.6,0.8"),
    "a line": ("--line", "--pose", "0.307", "0.1", "0.45"),
    "another planner": ("--pose", "0.5", "0.2", "0.3", "--planner", "ompl/RRTConnect"),
}


@pytest.mark.slow
@pytest.mark.parametrize("goal", GOALS.values(), ids=GOALS)
def test_a_plan_is_free_and_its_numbers_are_right(capsys, tmp_path, scene, goal):
    said = call(capsys, "plan", "panda_pick", *goal, "--json", tmp_path / "plan.json")
    assert said.status == 0, said.out
    data = read_json(tmp_path / "plan.json")
    path = np.array(data["path"])
    assert data["ok"] and data["waypoints"] == len(path)
    assert data["length_rad"] == pytest.approx(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    assert f"{data['duration_s']:.2f} s" in said.words and "clearance" in said.words
    checker = ExactChecker(scene.with_padding(0.0), data["joint_names"])
    for a, b in pairwise(path):
        for t in np.linspace(0, 1, 20):
            assert checker.is_free(a + t * (b - a))
    near = checker.nearest(path[-1])
    assert 0 < data["clearance_m"] <= near.distance + 1e-3


def test_where_it_ends(capsys, tmp_path, scene):
    call(capsys, "plan", "panda_pick", "--pose", "0.5", "0.2", "0.3", "--json", tmp_path / "p.json")
    data = read_json(tmp_path / "p.json")
    there = scene.with_state(JointState(tuple(data["joint_names"]), data["path"][-1]))
    assert there.frame_pose("panda_hand_tcp").translation == pytest.approx([0.5, 0.2, 0.3], abs=1e-4)


@pytest.mark.slow
def test_a_plan_that_fails_says_why_and_what_would_help(capsys, tmp_path):
    pose = ("--pose", "0.55", "0.06", "0.2")
    said = call(capsys, "plan", "panda_pick", *pose, "--json", tmp_path / "p.json")
    assert said.status == 1
    data = read_json(tmp_path / "p.json")
    assert data["code_name"] == "GOAL_IN_COLLISION" and data["path"] == [] and data["duration_s"] is None
    first = data["explanation"]["suggestions"][0]
    assert first["works"] and first["text"] in said.words and "wall" in said.words


def test_start_deg_moves_the_start(capsys, tmp_path):
    start = ("--start-deg", "panda_joint1=-20")
    call(capsys, "plan", "panda_pick", "--to", "extended", *start, "--json", tmp_path / "p.json")
    data = read_json(tmp_path / "p.json")
    assert data["path"][0][data["joint_names"].index("panda_joint1")] == pytest.approx(np.deg2rad(-20))


# --- ik, fk ---
def test_ik_and_fk_agree(capsys, tmp_path):
    said = call(capsys, "ik", "panda_pick", "--pose", "0.5", "0.2", "0.3", "--json", tmp_path / "ik.json")
    assert said.status == 0 and "this one is taken" in said.words
    data = read_json(tmp_path / "ik.json")
    values = " ".join(f"{v:.6f}" for v in data["positions"])
    call(capsys, "fk", "panda_pick", "--joints", values, "--json", tmp_path / "fk.json")
    pose = read_json(tmp_path / "fk.json")["links"]["panda_hand_tcp"]
    assert pose["xyz"] == pytest.approx([0.5, 0.2, 0.3], abs=1e-4)
    assert np.abs(pose["quat_xyzw"]) == pytest.approx([1, 0, 0, 0], abs=1e-4)  # half a turn about x
    assert any(s["free"] for s in data["solutions"]) and any(
        "limit" in s["reason"] for s in data["solutions"]
    )


def test_ik_that_fails_is_status_1_with_the_reason(capsys, tmp_path):
    said = call(capsys, "ik", "panda_pick", "--pose", "1.3", "0", "0.5", "--json", tmp_path / "ik.json")
    assert said.status == 1 and "cannot reach the pose" in said.words
    assert read_json(tmp_path / "ik.json")["explanation"]["suggestions"]


def test_fk_in_degrees_of_one_link(capsys):
    """A Panda's shoulder is 0.333 m above its base (its data sheet)."""
    said = call(capsys, "fk", "panda_pick", "--joints-deg", HOME_DEG, "--link", "panda_link2")
    assert said.status == 0 and "0.0000 0.0000 0.3330" in said.words.replace("-0.0000", "0.0000")
    assert "panda_link3" not in said.out


# --- check-state ---
def test_a_free_state(capsys, tmp_path):
    said = call(capsys, "check-state", "panda_pick", "--json", tmp_path / "s.json")
    data = read_json(tmp_path / "s.json")
    assert said.status == 0 and data["ok"] and data["contacts"] == [] and "nearest" in said.words
    assert data["nearest"]["distance"] > 0


def test_a_state_in_collision(capsys, tmp_path, scene):
    words = "panda_joint2=60 panda_joint4=-60"
    said = call(capsys, "check-state", "panda_pick", "--joints-deg", words, "--json", tmp_path / "s.json")
    data = read_json(tmp_path / "s.json")
    assert said.status == 1 and not data["ok"] and data["within_limits"]
    q = scene.state.updated(JointState(("panda_joint2", "panda_joint4"), np.deg2rad([60, -60]))).positions
    expected = [c.describe() for c in ExactChecker(scene).contacts(q, padded=False)]
    assert expected and all(text in said.words for text in expected)


def test_a_state_out_of_limits(capsys, tmp_path):
    said = call(
        capsys, "check-state", "panda_pick", "--joints-deg", "panda_joint4=10", "--json", tmp_path / "s.json"
    )
    assert said.status == 1
    margins = read_json(tmp_path / "s.json")["limit_margins"]
    assert margins["panda_joint4"] == pytest.approx(-0.0698 - np.deg2rad(10), abs=1e-4)


@pytest.mark.long
# --- explain ---
def test_explain_a_line_that_stops(capsys, tmp_path):
    said = call(
        capsys, "explain", "panda_pick", "--line", "--pose", "0.9", "0", "0.45", "--json", tmp_path / "e.json"
    )
    assert said.status == 1 and "it stops at" in said.words
    data = read_json(tmp_path / "e.json")
    assert not data["possible"] and 0 < data["explanation"]["data"]["fraction"] < 1


@pytest.mark.slow
def test_explain_shows_it(capsys):
    said = call(capsys, "explain", "panda_pick", "--pose", "0.55", "0.06", "0.2", "--view", "--port", "8097")
    assert said.status == 1 and "view: http://127.0.0.1:" in said.out


# --- typed wrong ---
WRONG = {
    "no goal": ("plan", "panda_pick"),
    "two goals": ("plan", "panda_pick", "--to", "home", "--pose", "0.5", "0", "0.3"),
    "a line to a named state": ("plan", "panda_pick", "--to", "home", "--line"),
    "ik of nothing": ("ik", "panda_pick"),
    "two states": ("check-state", "panda_pick", "--to", "home", "--joints-deg", HOME_DEG),
    "time is a word": ("plan", "panda_pick", "--to", "home", "--time", "long"),
}


@pytest.mark.parametrize("arguments", WRONG.values(), ids=WRONG)
def test_wrong_usage_is_status_2(capsys, arguments):
    said = call(capsys, *arguments)
    assert said.status == 2 and said.err and "internal error" not in said.err


INPUT = {
    "too few joints": (
        ("plan", "panda_pick", "--joints-deg", "1 2 3"),
        "3 joint positions given, group 'arm' has 7",
    ),
    "no number": (("fk", "panda_pick", "--joints-deg", "panda_joint1=left"), "'left' is not a number"),
    "no such joint": (("check-state", "panda_pick", "--joints", "joint1=0"), "unknown joint 'joint1'"),
    "no such state": (("plan", "panda_pick", "--to", "hme"), "did you mean 'home'?"),
    "no such planner": (("plan", "panda_pick", "--to", "home", "--planner", "ompl/RRTstarr"), "'RRTstar'"),
    "no such pipeline": (
        ("plan", "panda_pick", "--to", "home", "--planner", "omlp/RRT"),
        "did you mean 'ompl'",
    ),
    "no such link": (("fk", "panda_pick", "--link", "hand"), "unknown frame 'hand'"),
    "no such group": (("ik", "panda_pick", "--pose", "0", "0", "1", "--group", "leg"), "known: arm"),
    "no such cell": (("doctor", "panda_pik"), "did you mean 'panda_pick'?"),
    "time 0": (("plan", "panda_pick", "--to", "home", "--time", "0"), "must be positive"),
}


@pytest.mark.slow
@pytest.mark.parametrize(("arguments", "words"), INPUT.values(), ids=INPUT)
def test_wrong_input_is_status_1_and_lists_what_exists(capsys, arguments, words):
    said = call(capsys, *arguments)
    assert said.status == 1 and words in said.words + said.err


@pytest.mark.parametrize("command", ["plan", "ik", "fk", "check-state", "doctor", "explain"])
def test_help_teaches_with_an_example(capsys, command):
    said = call(capsys, command, "--help")
    assert said.status == 0 and "--json" in said.out and f"armcell {command} " in said.words


def test_json_that_cannot_be_written_is_said_before(capsys, tmp_path):
    for command in (("plan", "--to", "home"), ("ik", "--pose", "0.5", "0", "0.4"), ("fk",), ("check-state",)):
        said = call(capsys, command[0], "panda_pick", *command[1:], "--json", tmp_path / "none" / "x.json")
        assert said.status == 1 and said.out == "" and "folder does not exist" in said.err


def test_a_held_up_start_is_explained(capsys, tmp_path):
    text = (
        "robot: panda\nstart: {arm: home}\nobjects:\n  beam: {box: [0.1, 0.1, 0.1], pose: [0.307, 0, 0.62]}\n"
    )
    said = call(capsys, "plan", cell_file(tmp_path, text), "--to", "extended")
    assert said.status == 1 and "START_STATE_IN_COLLISION" in said.words and "move beam" in said.words
