"""doctor on a MoveIt package: joints that no controller moves, and names that the drivers do not have."""

from __future__ import annotations

from pathlib import Path

import pytest

from armcell.cli.doctor import check_cell

JOINT = """<joint name="j{i}" type="revolute"><parent link="l{p}"/><child link="l{i}"/><axis xyz="0 0 1"/>
  <limit lower="-1" upper="1" velocity="1" effort="1"/></joint><link name="l{i}"/>"""
URDF = f'<robot name="r"><link name="l0"/>{JOINT.format(i=1, p=0)}{JOINT.format(i=2, p=1)}</robot>'
SRDF = '<robot name="r"><group name="arm"><chain base_link="l0" tip_link="l2"/></group></robot>'
CONTROLLERS = """moveit_simple_controller_manager:
  controller_names: [arm_controller, other]
  arm_controller: {type: FollowJointTrajectory, default: true, joints: [j1, j2]}
  other: {type: FollowJointTrajectory, joints: [j1]}
"""
STARTED = """controller_manager:
  ros__parameters:
    update_rate: 100
    arm_controller: {type: joint_trajectory_controller/JointTrajectoryController}
    other: {type: joint_trajectory_controller/JointTrajectoryController}
arm_controller:
  ros__parameters: {joints: [j1, j2]}
"""


@pytest.fixture
def package(tmp_path) -> Path:
    config = tmp_path / "config"
    config.mkdir()
    for name, text in {
        "r.urdf": URDF, "r.srdf": SRDF, "joint_limits.yaml": "joint_limits: {}\n", "kinematics.yaml": "{}\n",
        "moveit_controllers.yaml": CONTROLLERS, "ros2_controllers.yaml": STARTED,
    }.items():  # fmt: skip
        (config / name).write_text(text)
    return tmp_path


def wrong(package: Path, file: str, old: str, new: str) -> list[str]:
    path = package / "config" / file
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    return [f"{line.check}: {line.found}" for line in check_cell(str(package)) if line.verdict == "no"]


def test_a_sound_one(package):
    lines = list(check_cell(str(package)))
    assert {line.verdict for line in lines} == {"ok"}
    assert {"MoveIt package", "controller arm_controller", "ros2_controllers.yaml"} <= {
        x.check for x in lines
    }


@pytest.mark.parametrize(
    ("file", "old", "new", "told"),
    [
        ("moveit_controllers.yaml", "[j1, j2]", "[j1]", "no controller moves j2"),
        ("moveit_controllers.yaml", "other: {type: FollowJointTrajectory", "other: {default: true, type: x",
         "is in arm_controller and other"),
        ("moveit_controllers.yaml", "j2]", "j3]", "unknown joint 'j3'"),
        ("ros2_controllers.yaml", "    other:", "    others:", "did you mean 'others'"),
        ("ros2_controllers.yaml", "[j1, j2]", "[j1]", "other joints than in moveit_controllers.yaml: j2"),
        ("ros2_controllers.yaml", "controller_manager:", "{", "cannot be read"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named(package, file, old, new, told):
    lines = wrong(package, file, old, new)
    assert any(told in line for line in lines), lines
