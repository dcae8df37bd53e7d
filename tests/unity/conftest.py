"""What the tests of the Unity package share."""

from __future__ import annotations

import pytest
from tests.unity.mono import Player, need_mono

from armcell.cell import load
from armcell.ros.unity import export_unity


@pytest.fixture(scope="session")
def player(tmp_path_factory):
    """The compiled player of a protocol, made when first asked for."""
    need_mono()
    made = {}

    def get(ros2=False):
        if ros2 not in made:
            made[ros2] = Player(tmp_path_factory.mktemp("ros2" if ros2 else "ros1"), ros2)
        return made[ros2]

    return get


@pytest.fixture(scope="session")
def exported(tmp_path_factory):
    """(cell, export) of panda_table."""
    cell = load("panda_table")
    return cell, export_unity(cell, tmp_path_factory.mktemp("project"))


@pytest.fixture
def scene(exported):
    return exported[1].cell / "scene.json"
