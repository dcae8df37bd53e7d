"""Faults of a robot that a xacro file describes: the message names the line of the xacro file, and a hint."""

from __future__ import annotations

import pytest
from tests.model.helpers import collision, joint, link

from armcell.cell.setup import propose
from armcell.core import InputError
from armcell.model import load_urdf
from armcell.model.setup import UrdfPart

MAIN = """<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:include filename="part.xacro"/>
  <xacro:arg name="speeds" default=""/>

  <link name="base"/>
  <xacro:part name="arm"/>
</robot>
"""


def robot(folder, lines: list[str]):
    """r.xacro calls the macro of part.xacro, whose line 3 is the first of `lines`."""
    head = ['<robot xmlns:xacro="http://www.ros.org/wiki/xacro">', '<xacro:macro name="part" params="name">']
    (folder / "part.xacro").write_text("\n".join([*head, *lines, "</xacro:macro>", "</robot>"]))
    (folder / "r.xacro").write_text(MAIN)
    return folder / "r.xacro"


JOINT = joint("j", "base", "${name}")
FAULTS = {
    "missing mesh": (
        [link("${name}", "\n" + collision('<mesh filename="no.stl"/>')), JOINT],
        r"part\.xacro:4: <mesh>: mesh file .*no\.stl not found \(part of .*r\.xacro\) \(check the path\)",
    ),
    "missing limit": (
        [link("${name}"), joint("j", "base", "${name}", limit="")],
        r"part\.xacro:4: <joint name='j'>: a revolute joint needs <limit>.*add <limit lower=",
    ),
    "unknown link": (
        [link("${name}"), joint("j", "base", "hand")],
        r"part\.xacro:4: <joint name='j'>: child link 'hand' does not exist",
    ),
    "file that an empty argument names": (
        ["<link name=\"${load_yaml(xacro.arg('speeds'))}\"/>"],
        r"part\.xacro:3: .*is a folder, a file is needed.*depend on arguments: speeds=''",
    ),
}


@pytest.mark.parametrize(("lines", "message"), FAULTS.values(), ids=FAULTS)
def test_a_fault_is_named_with_the_line_of_the_file_that_has_it(tmp_path, lines, message):
    with pytest.raises(InputError, match=message):
        load_urdf(robot(tmp_path, lines))


@pytest.mark.slow
def test_warnings_have_the_line_of_the_xacro_file_and_setup_gives_each_once(tmp_path, caplog):
    body = '<inertial><mass value="1"/><inertia ixx="1" iyy="-0.1" izz="0.1"/></inertial>'
    limit = '<limit lower="-170" upper="170" velocity="1" effort="1"/>'
    lines = [link("${name}", body), joint("j", "base", "${name}", limit=limit)]
    propose([UrdfPart(robot(tmp_path, lines))], samples=100)
    assert [r.getMessage().split(": ", 1)[0] for r in caplog.records] == [
        f"{tmp_path}/part.xacro:3", f"{tmp_path}/part.xacro:4",
    ]  # fmt: skip
    assert "the inertia of link 'arm' is not of a real body" in caplog.text
    assert "-170 to 170 rad, look like degrees" in caplog.text


def test_setup_names_the_line_of_the_urdf(tmp_path):
    file = tmp_path / "r.urdf"
    file.write_text(
        "<robot name='r'>\n\n\n<link name='a'/><link name='b'/>\n" + joint("j", "a", "c") + "</robot>"
    )
    with pytest.raises(InputError, match=r"r\.urdf:5: <joint name='j'>: child link 'c' does not exist"):
        propose([UrdfPart(file)], samples=100)


def test_a_file_of_macros_names_the_files_that_call_them(tmp_path):
    robot(tmp_path, [link("${name}"), JOINT])
    with pytest.raises(
        InputError, match=r"has no <link> \(.*give a file that calls them; r\.xacro includes it"
    ):
        load_urdf(tmp_path / "part.xacro")


@pytest.mark.slow
def test_a_package_without_the_file_is_named(tmp_path):
    (tmp_path / "package.xml").write_text("<package><name>arm_description</name></package>")
    mesh = collision('<mesh filename="package://arm_description/meshes/no.stl"/>')
    file = robot(tmp_path, [link("${name}", mesh), JOINT])
    with pytest.raises(
        InputError, match=f"package 'arm_description' is {tmp_path}, but has no file 'meshes/no"
    ):
        load_urdf(file)


def test_a_color_without_opacity_is_opaque(tmp_path):
    visual = (
        '<visual><geometry><sphere radius="1"/></geometry><material><color rgba="1 0 0"/></material></visual>'
    )
    model = load_urdf(robot(tmp_path, [link("${name}", visual), JOINT]))
    assert model.links["arm"].visuals[0].color == (1.0, 0.0, 0.0, 1.0)
