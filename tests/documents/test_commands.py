"""The shell commands of the documents: docs/coming_from_moveit.md says what to type instead."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from tests.documents.reading import DUAL, PICK_PLACE, UNITY, document

from armcell.cli.main import main

PAGE = Path(__file__).parents[2] / "docs" / "coming_from_moveit.md"
COMMANDS = re.compile(
    r"roslaunch [a-z0-9_]+ ([a-z0-9_]+\.launch)|rosrun [a-z0-9_]+ ([a-z_.0-9]+)|(rostopic [a-z]+)|"
    r"(rosnode [a-z]+)|(check_urdf)|(catkin[_ ][a-z_]+)|(netstat -[a-z]+)|(git clone)|"
    r"(pip install [a-z-]+)|(apt)(?:-get)? install"
)
OWN = {"marm_empty_world.launch": "WORLD.launch", "gazebo_world.launch": "WORLD.launch"}


def table() -> str:
    text = PAGE.read_text(encoding="utf-8")
    return text[text.index("## Commands of ROS tutorials") : text.index("## What is different")]


@pytest.mark.parametrize("name", [UNITY, PICK_PLACE, DUAL])
def test_each_command_has_its_row(name):
    found = ["".join(groups) for groups in COMMANDS.findall(document(name))]
    assert found
    for command in found:
        assert OWN.get(command, command) in table(), command


def test_the_commands_of_armcell_exist(capsys):
    commands = {
        tuple(words.split()[1 : 3 if words.split()[1] == "topic" else 2])
        for words in re.findall(r"`(armcell [^`]+)`", table())
    }
    assert len(commands) > 8
    for command in commands:
        assert main([*command, "--help"]) == 0, command
    capsys.readouterr()
