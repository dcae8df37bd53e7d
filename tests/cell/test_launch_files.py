"""Launch files that `armcell setup` writes: ROS 1's by roslaunch, ROS 2's with its API recorded."""

from __future__ import annotations

import shutil
import subprocess
import sys
import types
from pathlib import Path

import pytest
import yaml
from tests.cell.test_setup import small_arm
from tests.cli.helpers import call

from armcell.cell.setup import propose, propose_from_package, write_cell
from armcell.model.setup import UrdfPart


@pytest.fixture
def folder(tmp_path) -> Path:
    folder = tmp_path / "my_cell"
    write_cell(propose([UrdfPart(small_arm(tmp_path))], 1000), folder)
    return folder


def test_the_guide_names_package_files_and_controllers(folder):
    text = (folder / "LAUNCH.md").read_text()
    for words in (
        "ros2 launch my_cell move_group.launch.py",
        "roslaunch launch/move_group.launch",
        "armcell serve . ",
    ):
        assert words in text
    assert "`arm_controller/follow_joint_trajectory` (FollowJointTrajectory): j1, j2, j3" in text
    assert "install(DIRECTORY config launch DESTINATION" in (folder / "CMakeLists.txt").read_text()


def test_the_ros_2_file(folder, monkeypatch):
    """It builds the configuration of this package and launches what the two generators give."""
    asked = []

    class Builder:
        def __init__(self, robot, package_name):
            asked.append((robot, package_name))

        def to_moveit_configs(self):
            return "config"

    def module(name: str, **content):
        monkeypatch.setitem(sys.modules, name, types.SimpleNamespace(**content))

    made = lambda *names: lambda config: types.SimpleNamespace(entities=[(config, n) for n in names])  # noqa: E731
    module("launch", LaunchDescription=lambda entities: entities)
    module("moveit_configs_utils", MoveItConfigsBuilder=Builder)
    module(
        "moveit_configs_utils.launches",
        generate_move_group_launch=made("move_group"), generate_rsp_launch=made("rate", "rsp"),
    )  # fmt: skip
    space: dict = {}
    exec(compile((folder / "launch/move_group.launch.py").read_text(), "move_group.launch.py", "exec"), space)
    assert space["generate_launch_description"]() == [("config", n) for n in ("rate", "rsp", "move_group")]
    assert asked == [("r", "my_cell")]


@pytest.mark.interop
def test_roslaunch_loads_the_ros_1_file(folder, tmp_path):
    if not shutil.which("roslaunch"):
        pytest.skip("ROS 1 is not installed (apt-get install python3-roslaunch)")
    for made in (folder, _again(folder, tmp_path)):
        command = ["roslaunch", "--dump-params", made / "launch/move_group.launch"]
        said = subprocess.run(command, capture_output=True, text=True, timeout=60)
        assert said.returncode == 0, said.stderr
        found = yaml.safe_load(said.stdout)
        assert "<robot" in found["/robot_description"] and "<group" in found["/robot_description_semantic"]
        assert found["/robot_description_planning/joint_limits/j1/has_velocity_limits"] is not None
        assert found["/robot_description_kinematics/arm/kinematics_solver"]
        assert found["/move_group/planning_pipelines/ompl/planner_configs/RRTConnectkConfigDefault/type"]
        (controller,) = found["/move_group/controller_list"]
        assert controller["name"] == "arm_controller" and controller["joints"] == ["j1", "j2", "j3"]


def _again(folder: Path, tmp_path: Path) -> Path:
    """A cell on the package that was written."""
    write_cell(propose_from_package(folder), tmp_path / "again")
    return tmp_path / "again"


@pytest.mark.slow
def test_setup_says_where_the_guide_is_and_its_last_command_runs(tmp_path, capsys):
    """The commands at the end of `setup --help`, on a fresh cell."""
    said = call(capsys, "setup", "--help")
    commands = [line.split() for line in said.out.splitlines() if line.strip().startswith("armcell ")]
    *_, check, run = commands
    assert check == ["armcell", "check", "my_cell"] and run == ["armcell", "run", "my_cell"]
    cell = tmp_path / "my_cell"
    said = call(capsys, "setup", small_arm(tmp_path), "-o", cell, "--samples", 1000)
    assert said.status == 0 and f"{cell}/LAUNCH.md" in said.words
    assert call(capsys, "check", cell).status == 0
    assert call(capsys, "run", cell, "--runs", tmp_path / "runs").status == 0
