"""Arguments of xacro files and folders of packages: Python, command line, cells, MoveIt packages."""

from __future__ import annotations

import pytest

from armcell.core import InputError
from armcell.model import load_robot
from armcell.model.command_line_options import PACKAGES, XACRO_ARGS, assignments, set_packages, set_xacro_args

XACRO = """<robot xmlns:xacro="http://ros.org/wiki/xacro" name="arm$(arg dof)">
  <xacro:arg name="dof" default="2"/>
  <link name="base"/>
  <link name="tip"/>
  <joint name="$(arg side)_joint" type="continuous"><parent link="base"/><child link="tip"/></joint>
</robot>"""


@pytest.fixture
def file(tmp_path, monkeypatch):
    monkeypatch.setenv(XACRO_ARGS, "")  # restored at the end, whatever a test sets
    monkeypatch.setenv(PACKAGES, "")
    path = tmp_path / "arm.urdf.xacro"
    path.write_text(XACRO)
    return path


def test_a_missing_argument_is_named_with_the_way_to_pass_it(file):
    with pytest.raises(InputError, match=r"xacro:5: .*argument 'side' has no value.*--xacro-arg side:=VALUE"):
        load_robot(file)


def test_all_missing_arguments_are_named_at_once(file):
    file.write_text(XACRO.replace('name="tip"', 'name="$(arg end)"'))
    with pytest.raises(InputError, match=r"--xacro-arg end:=VALUE --xacro-arg side:=VALUE"):
        load_robot(file)


def test_arguments_of_a_call_and_a_default_used_before_its_declaration(file):
    model = load_robot(file, xacro_args={"side": "left"})
    assert model.name == "arm2" and model.joint_names == ("left_joint",)


def test_the_command_line_replaces_other_arguments(file):
    set_xacro_args(["side:=right", "dof:=7"])
    model = load_robot(file, xacro_args={"side": "left"})
    assert model.name == "arm7" and model.joint_names == ("right_joint",)


def test_arguments_in_robot_yaml(file):
    (file.parent / "robot.yaml").write_text("urdf: arm.urdf.xacro\nxacro_args: {side: up, dof: 3}\n")
    assert load_robot(file.parent).joint_names == ("up_joint",)


def test_arguments_in_a_cell(file):
    from armcell.cell import load

    (file.parent / "cell.yaml").write_text("robot: {model: arm.urdf.xacro}\nxacro_args: {side: down}\n")
    assert load(str(file.parent / "cell.yaml")).model.joint_names == ("down_joint",)


def test_an_unknown_argument_is_reported(file, caplog):
    load_robot(file, xacro_args={"side": "left", "dfo": "3"})
    assert "no xacro argument dfo; it has dof, side" in caplog.text


def test_a_named_package_comes_first(file, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    file.write_text(
        XACRO.replace('<link name="base"/>', '<xacro:include filename="$(find parts)/base.xacro"/>')
    )
    (tmp_path / "elsewhere" / "base.xacro").write_text('<robot><link name="base"/></robot>')
    with pytest.raises(InputError, match="--package parts=FOLDER"):
        load_robot(file, xacro_args={"side": "left"})
    set_packages([f"parts={tmp_path / 'elsewhere'}"])
    assert "base" in load_robot(file, xacro_args={"side": "left"}).links


def test_a_file_that_an_argument_selects(file):
    file.write_text(XACRO.replace('<link name="base"/>', '<xacro:include filename="arms/$(arg dof).xacro"/>'))
    (file.parent / "arms").mkdir()
    (file.parent / "arms" / "6.xacro").write_text("<robot/>")
    with pytest.raises(InputError, match=r"2.xacro not found .*arms has 6.xacro; .*dof='2'"):
        load_robot(file, xacro_args={"side": "left"})


@pytest.mark.parametrize("word", ["dof", ":=7", "a b:=7", "dof=7"])
def test_bad_words(word):
    with pytest.raises(InputError, match="--xacro-arg NAME:=VALUE"):
        assignments([word], ":=", "--xacro-arg")
