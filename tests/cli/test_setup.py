"""`armcell setup`: what it says, writes and refuses."""

from __future__ import annotations

import re

import numpy as np
import pytest
from PIL import Image
from tests.cell.test_setup import small_arm
from tests.cli.helpers import call
from tests.model.helpers import robot
from tests.model.test_setup_cups import two_cups
from tests.model.test_setup_gripper import jaw_parts

from armcell.cell.pictures import AXES, CLOSING, PAD
from armcell.cell.setup import propose
from armcell.cli.setup import STEPS
from armcell.model import SuctionGripper, load_robot
from armcell.model.setup import UrdfPart

QUICK = ("--samples", "500")


def test_help_teaches(capsys):
    said = call(capsys, "setup", "--help")
    assert said.status == 0
    for word in (
        "--prefix",
        "--at",
        "--force",
        "--web",
        "--gripper",
        "closes=lower|upper",
        "--samples",
        "armcell check my_cell",
        "left_",
        "MoveIt",
    ):
        assert word in said.out


@pytest.mark.slow
def test_a_cell_that_check_and_run_accept(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    said = call(capsys, "setup", small_arm(tmp_path), "-o", tmp_path / "cell", *QUICK)
    assert said.status == 0, said.err
    assert "3 driven joints" in said.words and "500 states" in said.words and "armcell check" in said.words
    assert call(capsys, "check", tmp_path / "cell").status == 0
    said = call(capsys, "run", tmp_path / "cell", "--mode", "fake", "--json", tmp_path / "run.json")
    assert said.status == 0, said.err


@pytest.mark.slow
@pytest.mark.cases("two robots", "a package without poses")
@pytest.mark.parametrize("kind", ["one robot", "two robots", "a package", "a package without poses"])
def test_the_commands_that_the_help_ends_with_work_on_a_fresh_cell(capsys, tmp_path, monkeypatch, kind):
    lines = call(capsys, "setup", "--help").out.split("Then:")[-1].split("\n")
    commands = [line.split()[1:] for line in lines if line.strip().startswith("armcell ")]
    assert [command[0] for command in commands] == ["check", "run"]
    monkeypatch.chdir(tmp_path)
    file = small_arm(tmp_path)
    two = ("--prefix", "a_", "--prefix", "b_")
    assert (
        call(
            capsys, "setup", file, *([file, *two] if kind == "two robots" else []), "-o", "my_cell", *QUICK
        ).status
        == 0
    )
    if kind.startswith("a package"):
        (tmp_path / "my_cell").rename(tmp_path / "package")
        if "without" in kind:
            for srdf in (tmp_path / "package" / "config").glob("*.srdf"):
                srdf.write_text(re.sub(r"<group_state.*?</group_state>", "", srdf.read_text(), flags=re.S))
        assert call(capsys, "setup", "package", "-o", "my_cell").status == 0
    for command in commands:
        said = call(capsys, *command)
        assert said.status == 0, said.err


def test_two_robots(capsys, tmp_path):
    file = small_arm(tmp_path)
    said = call(
        capsys, "setup", file, file, "--prefix", "a_", "--prefix", "b_",
        "--at", "0,1,0", "--at", "0,-1,0", "-o", tmp_path / "two", *QUICK,
    )  # fmt: skip
    assert said.status == 0, said.err
    assert "a_arm" in said.out and "b_arm" in said.out and "both_arms" in said.out
    assert call(capsys, "check", tmp_path / "two").status == 0


def test_a_package(capsys, tmp_path):
    assert call(capsys, "setup", small_arm(tmp_path), "-o", tmp_path / "one", *QUICK).status == 0
    said = call(capsys, "setup", tmp_path / "one", "-o", tmp_path / "two")
    assert said.status == 0, said.err
    assert call(capsys, "check", tmp_path / "two").status == 0


USAGE = {
    "no prefix": (2, (), "need a --prefix each"),
    "one prefix": (2, ("--prefix", "a_"), "--prefix is given 1 times"),
    "one place": (2, ("--prefix", "a_", "--prefix", "b_", "--at", "0,0,0"), "--at is given 1 times"),
    "not numbers": (2, ("--prefix", "a_", "--prefix", "b_", "--at", "0,0", "--at", "0,0,0"), "three numbers"),
    "same prefix": (1, ("--prefix", "a_", "--prefix", "a_"), "not all different"),
}


@pytest.mark.parametrize("case", USAGE)
def test_two_robots_misnamed(capsys, tmp_path, case):
    status, options, message = USAGE[case]
    file = small_arm(tmp_path)
    said = call(capsys, "setup", file, file, *options, "-o", tmp_path / "cell")
    assert said.status == status and message in " ".join(said.err.replace("│", " ").split())
    assert not (tmp_path / "cell").exists()


def test_refuses_with_the_cure(capsys, tmp_path):
    file = small_arm(tmp_path)
    assert call(capsys, "setup", file).status == 2  # no -o
    said = call(capsys, "setup", tmp_path / "no.urdf", "-o", tmp_path / "cell")
    assert said.status == 1 and "no.urdf: file not found" in said.err
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "x").write_text("x")
    said = call(capsys, "setup", file, "-o", tmp_path / "full")
    assert said.status == 1 and "add --force" in said.err
    said = call(capsys, "setup", file, "-o", tmp_path / "a" / "b")
    assert said.status == 1 and "mkdir -p" in said.err
    (tmp_path / "bad.urdf").write_text("<robot name='r'><link name='a'/></robot>")
    said = call(capsys, "setup", tmp_path / "bad.urdf", "-o", tmp_path / "cell")
    assert said.status == 1 and "no joint that moves" in said.err
    said = call(capsys, "setup", tmp_path / "full", "-o", tmp_path / "cell")
    assert said.status == 2 and "MoveIt package" in said.err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bad.urdf", "full", "small.urdf"]


def jaws_robot(folder, second='<axis xyz="0 -1 0"/><mimic joint="left_finger"/>', lower=0.0):
    """An arm with two sliding jaws; `second` is the second jaw's <axis> and <mimic>."""
    file = folder / "jaws.urdf"
    text = robot(*jaw_parts(lower, 0.03, second))
    file.write_text(text.replace('<axis xyz="0 0 1"/>', '<origin xyz="0 0 0.1"/><axis xyz="0 1 0"/>'))
    return file


@pytest.mark.slow
def test_a_gripper_is_shown_as_numbers_and_as_a_picture(capsys, caplog, tmp_path):
    file = jaws_robot(tmp_path)
    gone = '<visual><geometry><mesh filename="gone.stl"/></geometry></visual></link>'
    file.write_text(file.read_text().replace("</link>", gone, 1))
    said = call(capsys, "setup", file, "-o", tmp_path / "cell", *QUICK)
    assert said.status == 0, said.err
    # Once, although setup loads the robot again from the folder that it has written.
    assert sum("visual meshes are missing" in r.getMessage() for r in caplog.records) == 1
    for text in (
        "opening 0 to 60 mm (joint left_finger: 0 to 0.03)",
        "closing along y of gripper_tcp: (0.00, 1.00, 0.00) in l4; out of the hand: (0.00, 0.00, 1.00)",
        "pads 20 x 24 mm, on left and right",
        "force 50 N per finger",
        "holds a cube of 27 mm",
        f"picture: {tmp_path}/cell/gripper.png",
    ):
        assert text in said.words
    with Image.open(tmp_path / "cell" / "gripper.png") as picture:
        pixels = np.asarray(picture.convert("RGB")).astype(int)
    assert pixels.shape == (480, 960, 3)
    for color in (PAD, CLOSING, *AXES.values()):  # both views show every mark
        marked = np.abs(pixels - color).sum(2) < 30
        assert marked[:, :480].any() and marked[:, 480:].any()


@pytest.mark.long
def test_jaws_that_stop_apart_have_a_picture(capsys, tmp_path):
    said = call(capsys, "setup", jaws_robot(tmp_path, lower=0.01), "-o", tmp_path / "cell", *QUICK)
    assert "opening 20 to 60 mm" in said.words and f"picture: {tmp_path}/cell/gripper.png" in said.words


def test_facts_that_the_meshes_contradict_write_nothing(capsys, tmp_path):
    said = call(
        capsys, "setup", jaws_robot(tmp_path), "-o", tmp_path / "cell", *QUICK, "--gripper", "closes=upper"
    )
    assert said.status == 1 and "does not close toward the upper limit" in said.err
    assert not (tmp_path / "cell").exists()


def test_a_terminal_is_asked_until_the_answer_holds(capsys, tmp_path, monkeypatch):
    answers = iter(["closes=sideways", "drive=left_finger fingers=left,l4", "end=gripper drive=l_joint", ""])
    monkeypatch.setattr("armcell.cli.setup.is_terminal", lambda: True)
    monkeypatch.setattr("builtins.input", lambda prompt: next(answers))
    file = jaws_robot(tmp_path, '<axis xyz="0 1 0"/><mimic joint="left_finger"/>')  # both move the same way
    said = call(capsys, "setup", file, "-o", tmp_path / "cell", *QUICK)
    assert said.status == 0, said.err
    assert "no two of its moving links move toward each other" in said.words
    assert "closes is 'lower' or 'upper'" in said.words and "l_joint is not a driven joint" in said.words
    assert next(answers, None) is None


def suction_robot(folder):
    """An arm with a body and two suction cups; its joints turn about y, so that it can reach downward."""
    file = folder / "cups.urdf"
    text = robot(*two_cups())
    file.write_text(text.replace('<axis xyz="0 0 1"/>', '<origin xyz="0 0 0.1"/><axis xyz="0 1 0"/>'))
    return file


@pytest.mark.slow
def test_suction_cups_are_asked_for_and_shown(capsys, tmp_path, monkeypatch):
    answers = iter(["cups=body", "suction"])
    monkeypatch.setattr("armcell.cli.setup.is_terminal", lambda: True)
    monkeypatch.setattr("builtins.input", lambda prompt: next(answers))
    said = call(capsys, "setup", suction_robot(tmp_path), "-o", tmp_path / "cell", *QUICK)
    assert said.status == 0, said.err
    asked, shown = said.words.split("link body has no circle")
    assert "left_cup, right_cup may be suction cups by name; pass --gripper suction" in asked
    for text in (
        "lifted and shaken in physics",
        "center gripper_tcp at (0, 0, 88) mm in body",
        "axis z of gripper_tcp, out of the cups: (0.00, 0.00, 1.00) in body",
        "left_cup at (0, 30, 0) mm in gripper_tcp, radius 20.0 mm, lip 2.0 mm; right_cup at (0, -30, 0) mm",
        "force 75; 75 N at 60 kPa below ambient, an assumed value",
        f"picture: {tmp_path}/cell/gripper.png (tcp frame and the rings of the cups)",
    ):
        assert text in shown
    with Image.open(tmp_path / "cell" / "gripper.png") as picture:
        pixels = np.asarray(picture.convert("RGB")).astype(int)
    assert all((np.abs(pixels - color).sum(2) < 30).any() for color in (PAD, *AXES.values()))
    gripper = load_robot(tmp_path / "cell").gripper()
    assert isinstance(gripper, SuctionGripper)
    assert [(c.link, c.radius, c.stroke) for c in gripper.cups] == [
        ("left_cup", 0.02, 0.002), ("right_cup", 0.02, 0.002)
    ]  # fmt: skip


def test_every_step_has_its_part_of_the_progress_bar(tmp_path):
    told = []
    propose([UrdfPart(small_arm(tmp_path))], samples=200, progress=lambda *at: told.append(at))
    assert list(dict.fromkeys(step for step, _ in told)) == list(STEPS)[:-1]
    ends = [STEPS[step][0] + done * (STEPS[step][1] - STEPS[step][0]) for step, done in told]
    assert ends == sorted(ends) and all(0 <= done <= 1 for _, done in told)
    assert [first for first, _ in STEPS.values()] == [0.0, *(last for _, last in STEPS.values())][:-1]
