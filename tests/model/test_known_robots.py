"""Robots by name: those that are here load, the others name their description."""

from __future__ import annotations

from pathlib import Path

import pytest

from armcell.core import InputError
from armcell.model import assets, installed_robots, known_robot, load_robot, robot_names

SHARED = Path(__file__).parents[3].joinpath("shared", "data", "robots").resolve()
AWAY = sorted(set(robot_names()) - set(installed_robots()))


@pytest.mark.parametrize("name", AWAY)
def test_a_robot_without_its_description_names_the_source(name):
    robot = known_robot(name)
    with pytest.raises(InputError, match=f"--package {robot.package}=FOLDER") as error:
        load_robot(name)
    assert robot.description.startswith("https://") and robot.description in str(error.value)


@pytest.mark.parametrize("name", ["panda", "dual_ur10"])
def test_a_robot_whose_meshes_an_extra_installs_names_the_extra(name, monkeypatch):
    monkeypatch.setattr(assets, "installed_share", list)
    robot = known_robot(name)
    assert robot.package == "example-robot-data" and "pip install 'armcell[robots]'" in robot.hint
    with pytest.raises(InputError, match=r"pip install 'armcell\[robots\]'"):
        load_robot(name)


@pytest.mark.parametrize("name", AWAY)
def test_a_robot_loads_with_its_makers_description(name, monkeypatch):
    folder = SHARED / (known_robot(name).package or "")
    if not folder.is_dir():
        pytest.skip("no shared data")
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(SHARED))
    try:
        model = load_robot(name)
    except InputError as error:
        if "not found" in str(error):
            pytest.skip(f"the shared description is not complete: {error}")
        raise
    assert model.group("arm").joint_names and model.named_state("arm", "home")
    model.check_positions(model.default_positions())
