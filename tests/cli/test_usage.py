"""Help, and what happens to a command that is typed wrong: status 2, one line, no traceback."""

from __future__ import annotations

import os
import re

import pytest
from tests.cli.helpers import call, cell_file, finished, start

import armcell

COMMANDS = ("run", "check", "explain", "cells")
OPTIONS = {
    "run": ["--seed", "--mode", "--view", "--json", "--headless", "--runs", "--time-scale", "--port"],
    "check": ["--json"],
    "explain": ["--pose", "--rpy-deg", "--pick", "--group", "--seed", "--json", "--view"],
    "cells": [],
}


@pytest.mark.parametrize("command", COMMANDS)
def test_help_shows_every_option(capsys, command):
    said = call(capsys, command, "--help")
    assert said.status == 0
    for option in OPTIONS[command]:
        assert option in said.out
    assert said.err == ""


def test_help_lists_the_commands_and_examples(capsys):
    said = call(capsys, "--help")
    assert said.status == 0
    assert all(command in said.out for command in COMMANDS)
    assert "armcell run panda_pick" in said.words


def test_version(capsys):
    said = call(capsys, "--version")
    assert (said.status, said.out.strip()) == (0, f"armcell {armcell.__version__}")


def test_cells_lists_what_is_built_in(capsys):
    said = call(capsys, "cells")
    assert said.status == 0
    for name in ("panda_pick", "six_axis_pick", "ur10_gripper"):
        assert name in said.out


WRONG = {
    "no command": (),
    "unknown command": ("runn", "panda_pick"),
    "no cell": ("run",),
    "two cells": ("check", "panda_pick", "six_axis_pick"),
    "unknown option": ("run", "panda_pick", "--sed", "1"),
    "no value": ("run", "panda_pick", "--seed"),
    "seed is a word": ("run", "panda_pick", "--seed", "one"),
    "seed below 0": ("run", "panda_pick", "--seed", "-1"),
    "time scale 0": ("run", "panda_pick", "--time-scale", "0"),
    "no such port": ("run", "panda_pick", "--port", "99999"),
    "headless view": ("run", "panda_pick", "--headless", "--view"),
    "nothing to explain": ("explain", "panda_pick"),
    "two things to explain": ("explain", "panda_pick", "--pick", "cube", "--pose", "0", "0", "1"),
    "pose of two": ("explain", "panda_pick", "--pose", "0.5", "0"),
}


@pytest.mark.slow
@pytest.mark.parametrize("arguments", WRONG.values(), ids=WRONG)
def test_wrong_usage_is_status_2(capsys, arguments):
    said = call(capsys, *arguments)
    assert said.status == 2
    assert said.err and "internal error" not in said.err


def test_wrong_usage_names_the_option_and_a_near_one(capsys):
    said = call(capsys, "run", "panda_pick", "--sed", "1")
    assert "--sed" in said.err and "--seed" in said.err


# --- wrong input: status 1, one line on standard error, nothing on standard output ---
@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("run", "panda_pik", "--headless"), "unknown cell 'panda_pik'; known: "),
        (("run", "panda_pik"), "unknown cell 'panda_pik'"),
        (("check", "none/cell.yaml"), "none/cell.yaml: file not found"),
        (("explain", "panda_pick", "--pick", "cub"), "unknown object 'cub'"),
        (("explain", "panda_pick", "--pose", "nan", "0", "0"), "not finite"),
        (
            ("explain", "panda_pick", "--pose", "0", "0", "1", "--group", "leg"),
            "unknown planning group 'leg'",
        ),
        (
            ("run", "panda_pick", "--headless", "--mode", "reel"),
            "unknown mode 'reel'; known: fake, real, sim",
        ),
        (("run", "panda_pick", "--headless", "--mode", "real"), "the cell has no real arms"),
        (("bringup", "panda_pick", "--yes"), "the cell has no real arms"),
        (("ur-controller", "--host", "127.0.9.9", "--host", "127.0.9.9"), "two arms have the same address"),
        (("new", "a" * 300, "--robot", "panda"), "File name too long"),
        (("new", "cell", "--robot", "parallel_gripper"), "robot 'parallel_gripper' has no arm"),
        (("ur-controller", "--model", "UR99"), "unknown UR model 'UR99'; known: UR10, UR10e"),
    ],
)
def test_wrong_input_is_one_line_and_status_1(capsys, arguments, reason):
    said = call(capsys, *arguments)
    assert said.status == 1
    assert said.out.strip() == ""
    (line,) = said.err.splitlines()
    assert line.startswith("armcell: ") and reason in line and "internal error" not in line


@pytest.mark.parametrize(
    ("text", "arguments"),
    [
        ("robot: ur10\nobjects: {cube: {sphere: 0.02, movable: true}}\ntask: [{pick: cube}]\n", ("check",)),
        ('<robot name="r"><link name="base"/></robot>', ("explain", "--pose", "0", "0", "1")),
    ],
    ids=["no gripper", "no group"],
)
def test_a_robot_that_lacks_what_is_asked_for(capsys, tmp_path, text, arguments):
    file = cell_file(tmp_path, text)
    if text.startswith("<"):
        (tmp_path / "r.urdf").write_text(text)
        file.write_text("robot: r.urdf\n")
    said = call(capsys, arguments[0], file, *arguments[1:])
    assert said.status == 1
    assert "internal error" not in said.err
    assert "gripper" in said.out + said.err or "group" in said.out + said.err


def test_the_error_names_the_line_of_a_broken_cell(capsys, tmp_path):
    file = cell_file(tmp_path, "robot: panda\nobjects: {a: [1\n")
    said = call(capsys, "run", file, "--headless")
    assert said.status == 1
    assert f"{file}:3: is not valid YAML" in said.err


@pytest.mark.slow
# --- as a process ---
def test_the_exit_status_of_the_process():
    said = finished(start("check", "panda_pik"))
    assert said.status == 1
    assert "unknown cell 'panda_pik'" in said.err and "Traceback" not in said.err


@pytest.mark.slow
def test_a_reader_that_goes_away_is_no_error():
    read, write = os.pipe()
    os.close(read)
    process = start("cells")
    process.stdout.close()
    process.stdout = None
    os.close(write)
    _, err = process.communicate(timeout=60)
    assert "Traceback" not in err and "internal error" not in err


def test_every_command_stands_under_a_heading(capsys):
    said = call(capsys, "--help").out
    headings = [line for line in said.splitlines() if line.endswith(":") and not line.startswith(" ")]
    assert len(headings) >= 6 and "Commands:" not in headings  # where those without one would stand
    assert all(re.search(rf"^  {name} ", said, re.M) for name in (*COMMANDS, "topic", "twin", "bench"))
