"""Files that are missing, not what they should be, or meant to do harm; unknown names."""

from __future__ import annotations

import os

import pytest
from tests.model.helpers import joint, link, robot

from armcell.core import InputError, UnknownNameError
from armcell.model import load_robot
from armcell.model.untrusted_files import MAX_TEXT_BYTES, read_text, read_yaml

LAUGHS = (
    '<!DOCTYPE r [<!ENTITY a "lol">'
    + "".join(f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in zip("abcdefghi", "bcdefghij"))
    + ']><robot name="r">&j;<link name="a" note="AT"/></robot>'
)
OUTSIDE = '<!DOCTYPE r [<!ENTITY e SYSTEM "file:///etc/passwd">]><robot name="r"><link name="&e;"/></robot>'
XACRO = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">{}</robot>'

FILES = {
    "not xml": ("r.urdf", b"robots are nice", "is not valid XML"),
    "cut off": ("r.urdf", b'<robot name="r">\n<link name="a"/>', "is not valid XML"),
    "other root": ("r.urdf", b"<sdf><model/></sdf>", "root element is not <robot>"),
    "binary": ("r.urdf", b"\xff\xfe\x00\x01", "is not UTF-8 text"),
    "empty": ("r.urdf", b"", "is not valid XML"),
    "doctype": ("r.urdf", b"<!DOCTYPE robot><robot name='r'><link name='a'/></robot>", "declares a DOCTYPE"),
    "entity bomb": ("r.urdf", LAUGHS.encode(), "entity"),
    "bomb in attribute": ("r.urdf", LAUGHS.replace("AT", "&j;").encode(), "entity"),
    "outside entity": ("r.urdf", OUTSIDE.encode(), "entity"),
    "xacro bomb": ("r.xacro", LAUGHS.encode(), "declares a DOCTYPE"),
    "xacro syntax": ("r.xacro", b"<robot", "is not valid XML"),
    "xacro macro": ("r.xacro", XACRO.format("<xacro:nope/>").encode(), "unknown macro name: xacro:nope"),
    "xacro recursion": (
        "r.xacro",
        XACRO.format('<xacro:macro name="m"><xacro:m/></xacro:macro><xacro:m/>').encode(),
        "xacro cannot expand it",
    ),
}
XACRO_NAME = ("r.xacro", XACRO.format('<link name="${nope}"/>').encode(), "'nope' is not defined")
LONG = pytest.param(*XACRO_NAME)


@pytest.mark.parametrize(("name", "data", "reason"), [*FILES.values(), LONG], ids=[*FILES, "xacro name"])
def test_a_broken_file_is_one_clear_line_at_once(tmp_path, within, name, data, reason):
    file = tmp_path / name
    file.write_bytes(data)
    with within(20), pytest.raises(InputError) as error:
        load_robot(file)
    text = str(error.value)
    assert text.startswith(str(file)) and reason in text and "\n" not in text


@pytest.mark.parametrize("name", ["no.urdf", "no.xacro", "no/such.urdf", "folder", "a.b"])
def test_a_missing_file_is_named(tmp_path, name):
    with pytest.raises(InputError) as error:
        load_robot(tmp_path / name)
    assert str(error.value).startswith(str(tmp_path / name)) and "no" in str(error.value)


def test_a_file_below_a_file_is_missing_too(tmp_path):
    (tmp_path / "r.urdf").write_text("<robot/>")
    with pytest.raises(InputError):
        load_robot(tmp_path / "r.urdf" / "r.urdf")


def test_a_folder_named_like_a_file(tmp_path):
    (tmp_path / "r.urdf").mkdir()
    with pytest.raises(InputError, match="is a folder, a file is needed"):
        read_text(tmp_path / "r.urdf")
    with pytest.raises(InputError, match=r"r\.urdf"):
        load_robot(tmp_path / "r.urdf")


def test_too_large_a_file_is_not_read(tmp_path):
    file = tmp_path / "r.urdf"
    with file.open("wb") as out:
        out.truncate(MAX_TEXT_BYTES + 1)
    with pytest.raises(InputError, match="is larger than"):
        load_robot(file)


def test_what_is_no_regular_file_is_not_read(tmp_path, within):
    os.mkfifo(tmp_path / "r.urdf")
    with within(10), pytest.raises(InputError):
        load_robot(tmp_path / "r.urdf")


@pytest.mark.parametrize("name", ["pandas", "ur10_griper", "UR10"])
def test_an_unknown_robot_is_suggested(name):
    with pytest.raises(UnknownNameError, match=r"unknown robot .*; known: .*panda, .*") as error:
        load_robot(name)
    if name != "UR10":
        assert "did you mean" in str(error.value)


YAML_BOMB = "a: &a [x, x]\n" + "".join(
    f"{b}: &{b} [{', '.join(['*' + a] * 9)}]\n" for a, b in zip("abcdefgh", "bcdefghi")
)
YAML = {
    "list": (b"- a\n- b\n", "top level is list, a mapping is needed"),
    "text": (b"just words", "top level is str"),
    "empty": (b"", "top level is NoneType"),
    "broken": (b"a: [1, 2\nb: 3\n", ":2: is not valid YAML"),
    "tab": (b"a:\n\tb: 1\n", ":2: is not valid YAML"),
    "bomb": (YAML_BOMB.encode(), "YAML aliases"),
    "python": (b"a: !!python/object/apply:os.getcwd []\n", ":1: is not valid YAML"),
    "binary": (b"\xff\xfe\xff", "is not UTF-8"),
}
CONTROL = pytest.param(b"a: \x00", "is not valid YAML")


@pytest.mark.parametrize(("data", "reason"), [*YAML.values(), CONTROL], ids=[*YAML, "control character"])
def test_bad_yaml_is_one_clear_line(tmp_path, within, data, reason):
    file = tmp_path / "robot.yaml"
    file.write_bytes(data)
    with within(20), pytest.raises(InputError) as error:
        read_yaml(file)
    text = str(error.value)
    assert text.startswith(str(file)) and reason in text and "\n" not in text


def test_only_true_and_false_are_booleans(tmp_path):
    (tmp_path / "a.yaml").write_text("on: yes\noff: true\n")
    assert read_yaml(tmp_path / "a.yaml") == {"on": "yes", "off": True}


URDF = robot(link("a"), link("b"), joint("j", "a", "b"))
SUCTION = "kind: suction, arm_group: a, group: g, tcp_link: a, hand_links: [b]"
ROBOT_YAML = [
    ("name: x\n", "needs one of 'urdf', 'mjcf' and 'parts'"),
    ("urdf: r.urdf\nparts: []\n", "needs one of 'urdf', 'mjcf' and 'parts'"),
    ("urdf: r.urdf\nsrfd: r.srdf\n", r"unknown key 'srfd'.*did you mean 'srdf'"),
    ("urdf: no.urdf\n", "urdf: .*no.urdf not found"),
    ("urdf: r.urdf\nroot: x\n", "unknown link 'x'"),
    ("urdf: r.urdf\nvisual_as_collision: x\n", "visual_as_collision: is not a list of link names"),
    ("urdf: r.urdf\nvisual_as_collision: [[a]]\n", "visual_as_collision: is not a list of link names"),
    ("parts: [{robot: scara}]\nvisual_as_collision: [a]\n", "visual_as_collision: does not apply to a robot"),
    ("parts: [{robot: scara}]\nroot: a\n", "root: does not apply to a robot of parts"),
    ("urdf: r.urdf\nvisual_as_collision: [x]\n", "unknown link 'x'"),
    ("urdf: r.urdf\nvisual_as_collision: [a]\n", "link 'a' has no visual shapes"),
    ("urdf: r.urdf\nsrdf: no.srdf\n", "no.srdf: file not found"),
    ("parts: []\n", "no parts"),
    ("parts: [{prefix: a_}]\n", "needs a 'robot'"),
    ("parts: [{robot: r.urdf, at: 3}]\n", "unknown key 'at'"),
    ("parts: [{robot: r.urdf, pose: [1]}]\n", "parts: pose: .* is not a pose"),
    ("urdf: r.urdf\ngrippers: {g: 3}\n", "grippers/g: is not a mapping"),
    ("urdf: r.urdf\ngrippers: {g: {max_with: 3}}\n", "unknown key 'max_with'.*did you mean 'max_width'"),
    ("urdf: r.urdf\ngrippers: {g: {max_width: 3}}\n", "grippers/g: is incomplete"),
    (
        "urdf: r.urdf\ngrippers: {g: {kind: magnet}}\n",
        "unknown kind of gripper 'magnet'; known: jaws, suction",
    ),
    (f"urdf: r.urdf\ngrippers: {{g: {{{SUCTION}, cups: []}}}}\n", "grippers/g: gripper 'g' has no cups"),
    (f"urdf: r.urdf\ngrippers: {{g: {{{SUCTION}}}}}\n", "grippers/g: is incomplete: .*'cups'"),
    (f"urdf: r.urdf\ngrippers: {{g: {{{SUCTION}, cups: [3]}}}}\n", "cups must be a list of mappings"),
    (
        f"urdf: r.urdf\ngrippers: {{g: {{{SUCTION}, cups: [{{link: a}}]}}}}\n",
        "a cup is incomplete: .*'radius'",
    ),
    (
        f"urdf: r.urdf\ngrippers: {{g: {{{SUCTION}, cups: [{{link: a, radius: 0.01, width: 1}}]}}}}\n",
        "unknown key of a cup 'width'; known: link, radius, rpy, stroke, xyz",
    ),
    (
        f"urdf: r.urdf\ngrippers: {{g: {{{SUCTION}, cups: [{{link: a, radius: 0.01, stroke: 0.02}}]}}}}\n",
        "radius 0.01 m and stroke 0.02 m .both must be positive, the stroke at most 0.004 m",
    ),
    (
        f"urdf: r.urdf\ngrippers: {{g: {{{SUCTION}, cups: [{{link: a, radius: 0.01}}], vacuum: 200}}}}\n",
        "vacuum 200 kPa.* .vacuum: at most 101.3 kPa",
    ),
    (
        f"urdf: r.urdf\ngrippers: {{g: {{{SUCTION}, cups: [{{link: nope, radius: 0.01}}]}}}}\n",
        "unknown link 'nope'",
    ),
    (f"urdf: r.urdf\ngrippers: {{g: {{{SUCTION}, finger_links: [a]}}}}\n", "unknown key 'finger_links'"),
    pytest.param("parts: 3\n", "parts"),
    pytest.param("parts: [{robot: 5}]\n", "robot"),
    pytest.param("parts: [{robot: .}]\n", "itself"),
    pytest.param("urdf: r.urdf\ngrippers: 3\n", "grippers"),
]


@pytest.mark.parametrize(("text", "reason"), ROBOT_YAML)
def test_bad_robot_yaml(tmp_path, text, reason):
    (tmp_path / "r.urdf").write_text(URDF)
    (tmp_path / "robot.yaml").write_text(text)
    with pytest.raises(InputError, match=reason) as error:
        load_robot(tmp_path)
    assert "\n" not in str(error.value)


def test_a_missing_visual_mesh_is_an_error_if_it_is_a_collision_shape(tmp_path):
    mesh = '<visual><geometry><mesh filename="no.stl"/></geometry></visual>'
    box = '<visual><geometry><box size="1 1 1"/></geometry></visual>'
    (tmp_path / "r.urdf").write_text(f'<robot name="r"><link name="a">{box}{mesh}</link></robot>')
    assert len(load_robot(tmp_path / "r.urdf").links["a"].visuals) == 1
    (tmp_path / "robot.yaml").write_text("urdf: r.urdf\nvisual_as_collision: [a]\n")
    with pytest.raises(InputError, match=r"no\.stl"):
        load_robot(tmp_path)


def test_a_link_of_an_mjcf_file_keeps_its_collision_shapes(tmp_path):
    geom = '<geom type="sphere" size="0.1" contype="0" conaffinity="0"/>'
    body = f'<body name="a">{geom}<joint name="j" range="-1 1"/></body>'
    (tmp_path / "r.xml").write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    (tmp_path / "robot.yaml").write_text("mjcf: r.xml\nvisual_as_collision: [a]\n")
    with pytest.raises(InputError, match="link 'a' is a body of an MJCF file"):
        load_robot(tmp_path)


def test_an_empty_prefix_is_no_prefix(tmp_path):
    (tmp_path / "r.urdf").write_text(URDF)
    (tmp_path / "robot.yaml").write_text("parts: [{robot: r.urdf, prefix: null}]")
    assert load_robot(tmp_path).joint_names == ("j",)
