"""Xacro files expanded beside the library `xacro`, element by element, and what it takes to stop them."""

from __future__ import annotations

import contextlib
import io
import time
from pathlib import Path

import pytest
import xacro
from lxml import etree
from xacro import substitution_args

from armcell.core import InputError
from armcell.model import load_robot
from armcell.model.xacro import expand_xacro

VENDORS = Path(__file__).parents[4].joinpath("shared", "data", "robots").resolve()  # may be a link
ROBOT = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">{}</robot>'


def canonical(text: str) -> tuple:
    """What a URDF says: tags, attributes and words, without comments, order of attributes, white space."""

    def of(element) -> tuple:
        inside = tuple(of(child) for child in element)
        words = tuple((text or "").strip() for text in (element.text, element.tail))
        return element.tag, tuple(sorted(element.attrib.items())), words, inside

    return of(etree.fromstring(text.encode(), etree.XMLParser(remove_comments=True)))


def by_the_library(file: Path, arguments: dict[str, str], packages: dict[str, Path]) -> str:
    substitution_args._eval_find = lambda name: str(packages[name])
    xacro.init_stacks(str(file))
    with contextlib.redirect_stderr(io.StringIO()):
        document = xacro.parse(file.read_text())
        xacro.process_doc(document, mappings=dict(arguments))
    return document.toxml()


VENDOR_FILES = [
    ("ur_description/urdf/ur.urdf.xacro", {"name": "ur", "ur_type": "ur5e"}),
    ("ur_description/urdf/ur.urdf.xacro", {"name": "ur", "ur_type": "ur10e", "tf_prefix": "left_"}),
    ("franka_description/robots/fr3/fr3.urdf.xacro", {}),
    ("franka_description/robots/fr3/fr3.urdf.xacro", {"gazebo": "true", "hand": "false"}),
    ("franka_description/robots/fer/fer.urdf.xacro", {"ros2_control": "true"}),
    ("franka_description/robots/fp3/fp3.urdf.xacro", {"no_prefix": "true"}),
    ("franka_description/robots/multi_arm/multi_arm.urdf.xacro", {}),
    ("xarm_description/urdf/xarm_device.urdf.xacro", {"dof": "7", "add_gripper": "true"}),
    ("xarm_description/urdf/xarm_device.urdf.xacro", {"dof": "5", "add_vacuum_gripper": "true"}),
    ("xarm_description/urdf/xarm_device.urdf.xacro", {"dof": "6", "robot_type": "lite"}),
    ("xarm_description/urdf/xarm_device.urdf.xacro", {"dof": "6", "add_other_geometry": "true"}),
    ("xarm_description/urdf/dual_xarm_device.urdf.xacro", {"dof_1": "7", "dof_2": "6"}),
    *(
        (
            "kortex_description/robots/kinova.urdf.xacro",
            {"arm": "gen3", "dof": "7", "gripper": hand, "name": "k", "robot_ip": "10.0.0.1"},
        )
        for hand in ("", "robotiq_2f_85", "robotiq_2f_140", "gen3_lite_2f")
    ),
    ("robotiq_description/urdf/robotiq_2f_85_gripper.urdf.xacro", {}),
    ("robotiq_description/urdf/robotiq_2f_140_gripper.urdf.xacro", {}),
]


@pytest.mark.slow
@pytest.mark.cases("franka_description/robots/fr3/*", "ur_description*", "robotiq*", "xarm*")
@pytest.mark.skipif(not VENDORS.is_dir(), reason="the vendors' descriptions are not on this machine")
@pytest.mark.parametrize(("name", "arguments"), VENDOR_FILES)
def test_descriptions_of_vendors_are_expanded_as_by_the_library(name, arguments):
    packages = {folder.name: folder for folder in VENDORS.iterdir()}
    ours = expand_xacro(VENDORS / name, arguments)
    assert canonical(ours) == canonical(by_the_library(VENDORS / name, arguments, packages))
    assert ours.count("<link") > 1


PACKAGE = {
    "package.xml": "<package><name>my_robot</name></package>",
    "config/limits.yaml": "joint_1: {lower: !degrees -90, upper: !degrees 45 * 2, has: yes, names: [a, b]}\n"
    "mass: 1.5\nwhen: 2024-01-02\nlength: !millimeters 250\n",
    "urdf/common.xacro": ROBOT.format(
        '<xacro:property name="density" value="7850"/>'
        '<xacro:macro name="cylinder" params="name r h:=0.1 *origin **extra color:=^|red mass:=${1.5*2}">'
        '<link name="${name}"><inertial><xacro:insert_block name="origin"/><mass value="${mass}"/></inertial>'
        '<xacro:insert_block name="extra"/><material name="${color}"/></link></xacro:macro>'
    ),
    "urdf/deep/inner.xacro": ROBOT.format('<xacro:include filename="../common.xacro"/><link name="inner"/>'),
}
FILES = {
    "properties": """
        <xacro:property name="a" value="${2*b}"/><xacro:property name="b" value="3"/><l v="${a}"/>
        <xacro:property name="b" value="5"/><l v="${a} ${b}" w="${a+b}"/>
        <xacro:property name="c" value="${b}" lazy_eval="false"/><xacro:property name="b" value="7"/>
        <l v="${c}"/><xacro:property name="d" default="8"/><xacro:property name="d" default="9"/>
        <l v="${d}"/><xacro:property name="t" value="true"/><l v="${t}"/>
        <xacro:property name="q" value="'12'"/><l v="${q + 3}"/><xacro:property name="u" value="1_0"/>
        <l v="${u}"/><xacro:property name="d" remove="true"/><l v="${1 if t else d}"/>""",
    "escapes": """<l v='$${a}' w='$$(b)' x='cost $5' y='$$$${z}'/><p>text ${1+1} $${x}</p>""",
    "conditions": """
        <xacro:arg name="n" default="2"/><xacro:if value="$(arg n)"><l v="1"/></xacro:if>
        <xacro:if value="${'$(arg n)' == '2'}"><l v="2"/>text</xacro:if>
        <xacro:unless value="false"><l v="3"/></xacro:unless>
        <xacro:unless value="1"><l v="${nope}"/></xacro:unless>""",
    "macros": """
        <xacro:include filename="$(find my_robot)/urdf/common.xacro"/>
        <xacro:property name="color" value="blue"/>
        <xacro:cylinder name="a" r="2"><origin xyz="0 0 ${density}"/>
          <more><m v="${1+1}"/><n/></more></xacro:cylinder>
        <xacro:macro name="twice" params="n:=1 name=x"><xacro:if value="${n}">
          <l v="${name}${n}"/><xacro:twice n="${n-1}"/></xacro:if></xacro:macro>
        <xacro:twice n="3"/><xacro:twice name='q r' n='1'/><xacro:call macro="${'tw' + 'ice'}"/>""",
    "loops": """
        <xacro:macro name="roller" params="n"><xacro:if value="${n > 0}"><l v="${n}"/>
          <xacro:if value="${n % 2 == 0}"><m/></xacro:if><xacro:roller n="${n-1}"/></xacro:if></xacro:macro>
        <xacro:roller n="150"/>""",
    "scopes": """
        <xacro:property name="x" value="1"/>
        <xacro:macro name="m"><xacro:property name="x" value="2"/><l v="${x}"/>
          <xacro:property name="y" value="3" scope="parent"/>
          <xacro:property name="z" value="4" scope="global"/></xacro:macro>
        <xacro:m/><l v="${x} ${y} ${z}"/>""",
    "name spaces": """
        <xacro:include filename="common.xacro" ns="com"/>
        <xacro:com.cylinder name="b" r="1" color="red"><origin/><extra/></xacro:com.cylinder>
        <l v="${com.density}"/><xacro:include filename="missing.xacro" optional="true"/>
        <xacro:include filename="deep/*.xacro"/>""",
    "yaml": """
        <xacro:property name="file" value="$(find my_robot)/config/limits.yaml"/>
        <xacro:property name="limits" value="${xacro.load_yaml(file)}"/>
        <l v="${limits.joint_1.lower}" w="${limits['joint_1']['upper']}" x="${limits.joint_1.has}"
           y="${limits.joint_1.names}" z="${limits.when} ${limits.length}"/>
        <l v="${'mass' in limits} ${sorted(limits.keys())} ${len(limits)}"/>""",
    "elements": """
        <xacro:element xacro:name="${'jo' + 'int'}" name="j">
          <xacro:attribute name="type" value="fixed"/><a/></xacro:element>
        <b><xacro:if value="1"><xacro:attribute name="c" value="d"/><e/></xacro:if></b>
        <xacro:property name="block"><f g="${h}"/>words</xacro:property>
        <xacro:property name="h" value="1"/>
        <i><xacro:insert_block name="block"/></i><xacro:insert_block name="block"/>""",
    "arguments": """
        <xacro:arg name="side" default="left"/><xacro:arg name="off" default="${pi/2}"/>
        <l v="$(arg side)_arm" w="${-$(arg off)}" x="$(eval 2 * 3)" y="$(eval off + 1)"
           z="${xacro.arg('side')}"/>
        <l v="${xacro.tokenize('1, 2;3')}" w="${xacro.dotify(dict(a=[1])).a[0]}"
           x="${radians(90) - pi/2}"/>""",
    "comments": "<!-- ${nope} --><a>b<!-- $(nope) -->c</a><![CDATA[d]]>",
}


@pytest.fixture
def package(tmp_path):
    for name, text in PACKAGE.items():
        file = tmp_path / "any_name" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    return tmp_path / "any_name"


@pytest.mark.slow
@pytest.mark.parametrize("name", FILES)
def test_what_descriptions_use_is_expanded_as_by_the_library(package, name):
    file = package / "urdf" / "r.urdf.xacro"
    file.write_text(ROBOT.format(FILES[name]))
    arguments = {"side": "right"} if name == "arguments" else {}
    library = by_the_library(file, arguments, {"my_robot": package})
    assert canonical(expand_xacro(file, arguments)) == canonical(library)


BOMBS = {
    "macro that calls itself": '<xacro:macro name="m"><xacro:m/></xacro:macro><xacro:m/>',
    "macros that call each other": '<xacro:macro name="a"><l><xacro:b/></l></xacro:macro>'
    '<xacro:macro name="b"><xacro:a/></xacro:macro><xacro:a/>',
    "tree of macros": "".join(
        f'<xacro:macro name="m{n}">{f"<xacro:m{n + 1}/>" * 10}</xacro:macro>' for n in range(20)
    )
    + '<xacro:macro name="m20"><link/></xacro:macro><xacro:m0/>',
    "file that includes itself": '<link/><xacro:include filename="r.xacro"/>',
    "tree of properties": '<xacro:property name="p0" value="x${0}"/>'
    + "".join(f'<xacro:property name="p{n + 1}" value="${{p{n}}}${{p{n}}}"/>' for n in range(60))
    + '<l v="${p60}"/>',
    "tree of lists": '<xacro:property name="p0" value="${[1]}"/>'
    + "".join(f'<xacro:property name="p{n + 1}" value="${{[p{n}, p{n}]}}"/>' for n in range(60))
    + '<l v="${p60}"/>',
    "property of itself": '<xacro:property name="a" value="${b}"/><xacro:property name="b" value="${a}"/>'
    '<l v="${a}"/>',
    "power": '<l v="${9**9**9}"/>',
    "long text": "<l v=\"${'a' * 10**10}\"/>",
    "blocks in blocks": '<xacro:property name="b0"><l/><l/></xacro:property>'
    + "".join(
        f'<xacro:property name="b{n + 1}">{f"""<xacro:insert_block name="b{n}"/>""" * 9}</xacro:property>'
        for n in range(30)
    )
    + '<xacro:insert_block name="b30"/>',
    "text in text": '<l><xacro:macro name="m" params="n">words<xacro:if value="${n}"><xacro:m n="${n-1}"/>'
    '<xacro:m n="${n-1}"/></xacro:if></xacro:macro><xacro:m n="99"/></l>',
    "parameters": f"<xacro:macro name='m' params='{'a' * 9000}&quot;'/>",
    "many parameters": f"<xacro:macro name='m' params='{'a:= ' * 9000}'/>",
    "deep": "<a>" * 300 + "</a>" * 300,
    "large integer": '<l v="${%s}"/>' % ("9" * 5000),
    "lazy chain": "".join(f'<xacro:property name="p{n + 1}" value="${{p{n}+1}}"/>' for n in range(5000))
    + '<xacro:property name="p0" value="0"/><l v="${p5000}"/>',
    "yaml": "<l v=\"${xacro.load_yaml('bomb.yaml')}\"/>",
    "yaml of itself": "<l v=\"${xacro.load_yaml('itself.yaml')}\"/>",
    "yaml keys": "<l v=\"${xacro.load_yaml('keys.yaml')}\"/>",
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.cases(
    "macro*",
    "tree of *",
    "*itself",
    "power",
    "long text",
    "*parameters",
    "deep",
    "large integer",
    "lazy chain",
    "yaml",
)
@pytest.mark.parametrize("name", BOMBS)
def test_a_file_that_never_ends_is_stopped(tmp_path, name, within):
    file = tmp_path / "r.xacro"
    file.write_text(ROBOT.format(BOMBS[name]))
    levels = [f"k{n}: &k{n} [{', '.join([f'*k{n - 1}'] * 3)}]" for n in range(1, 16)]
    (tmp_path / "bomb.yaml").write_text("\n".join(["k0: &k0 [1, 2]", *levels]))
    (tmp_path / "itself.yaml").write_text("a: &a [*a]")
    (tmp_path / "keys.yaml").write_text("\n".join(f"{n * (2**61 - 1)}: 0" for n in range(1, 60_000)))
    began = time.process_time()
    with within(30), pytest.raises(InputError) as error:
        load_robot(file)
    assert time.process_time() - began < 12
    assert str(error.value).startswith(str(tmp_path)) and "\n" not in str(error.value)


WRONG = [
    ("<xacro:m/>", "unknown macro name: xacro:m"),
    ('<xacro:macro name="m" params="a"/><xacro:m/>', "needs the parameters a"),
    ('<xacro:macro name="m" params="a"/><xacro:m a="1" b="2"/>', "invalid parameter 'b'"),
    ('<xacro:macro name="m" params="*a"/><xacro:m/>', "needs a block"),
    ('<xacro:macro name="m"/><xacro:m><a/></xacro:m>', "does not use the block"),
    ('<xacro:insert_block name="a"/>', "undefined block 'a'"),
    ('<xacro:if value="maybe"/>', "neither true nor false"),
    ('<xacro:property name="a b" value="1"/>', "not a valid name of a property"),
    ('<xacro:property name="__a" value="1"/>', "not a valid name of a property"),
    ('<xacro:property value="1"/>', "attribute 'name' is missing"),
    ('<xacro:element xacro:name="a b"/>', "not a valid name of an element"),
    ('<a><xacro:attribute name="a b" value="1"/></a>', "attribute 'a b'"),
    ('<a b="${1/0}"/>', "division by zero in ${1/0}"),
    ('<a b="${len}"/>', "len is a function, not a value"),
    ('<a b="${math}"/>', "NameSpace"),
    ('<a b="$(arg nope)"/>', "argument 'nope' has no value"),
    ('<a b="$(anon x)"/>', "not a substitution argument"),
    ('<a b="$(find no_such_package)"/>', "package 'no_such_package' not found"),
    ("<a b=\"${xacro.fatal('no such arm')}\"/>", "no such arm"),
    ('<a b="$$"/>', "invalid expression"),
    ("<a b=\"${xacro.load_yaml('%c.yaml' % 27)}\"/>", "is not a path"),
    ("<a b=\"$(arg ${'%c' % 27})\"/>", "has no value"),
    ("<a b=\"${xacro.fatal('%c' % 27)}\"/>", "xacro cannot expand it"),
    ("<a b=\"${'%c' % 27}\"/>", "attribute 'b'"),
    ("<a>${'%c' % 27}</a>", "text in <a>"),
]


@pytest.mark.parametrize(("text", "reason"), WRONG)
def test_a_mistake_is_named_with_its_line(tmp_path, text, reason):
    file = tmp_path / "r.xacro"
    file.write_text(ROBOT.format("\n" + text))
    with pytest.raises(InputError) as error:
        expand_xacro(file)
    said = str(error.value)
    assert said.startswith(f"{file}:2: <") and reason in said and said.isprintable()


def test_a_mistake_in_an_included_file_is_named_with_both(tmp_path):
    (tmp_path / "r.xacro").write_text(ROBOT.format('<xacro:include filename="my part.xacro"/>'))
    (tmp_path / "my part.xacro").write_text(ROBOT.format('\n\n<link name="${nope}"/>'))
    with pytest.raises(InputError) as error:
        expand_xacro(tmp_path / "r.xacro")
    said = str(error.value)
    assert (
        said.startswith(f"{tmp_path / 'my part.xacro'}:3: <link")
        and f"part of {tmp_path / 'r.xacro'}" in said
    )


def test_messages_of_a_file_hold_no_control_characters(tmp_path, caplog):
    text = "<a b=\"${xacro.warning('\\x1b]0;title\\x07 \\r look')}\"/>"
    (tmp_path / "r.xacro").write_text(ROBOT.format(text))
    expand_xacro(tmp_path / "r.xacro")
    (line,) = [record.getMessage() for record in caplog.records]
    assert "look" in line and line.isprintable()
