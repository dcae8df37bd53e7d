"""Faults of a stranger's robot: `armcell setup` names each one, with the line of the file and a hint."""

from __future__ import annotations

import pytest
from tests.cli.helpers import call
from tests.model.helpers import collision, joint, link, robot

from armcell.model.command_line_options import PACKAGES, XACRO_ARGS

BOX = collision('<box size="0.04 0.04 0.1"/>')
LIMIT = '<limit lower="{}" upper="{}" velocity="1" effort="50"/>'
JAW = '<collision><origin xyz="0 {} 0.04"/><geometry><box size="0.02 0.01 0.06"/></geometry></collision>'


def arm(*more: str, base: str = link("base", BOX), first: str = "", body: str = BOX) -> tuple[str, ...]:
    """An arm of three joints: line 2 is the link `base`, line 3 the link l1 and line 4 its joint."""
    parts = [base, link("l1", body), first or joint("j1", "base", "l1")]
    for i in (2, 3):
        inside = f'<origin xyz="0 0 0.2"/><axis xyz="{"0 1 0" if i == 2 else "1 0 0"}"/>'
        parts += [link(f"l{i}", BOX), joint(f"j{i}", f"l{i - 1}", f"l{i}", inside=inside)]
    return (*parts, *more)


def hand(gap: float, upper: float, mimic: str = '<mimic joint="left_finger"/>') -> tuple[str, ...]:
    """Two jaws that slide in y; their pads are `gap` - 5 mm from the middle if the joint is at 0."""
    at, sides = '<origin xyz="0 0 0.05"/>', ("left", "right")
    limit = LIMIT.format(0, upper)
    return (
        *(link(f"{side}_jaw", JAW.format(sign * gap)) for side, sign in zip(sides, (1, -1), strict=True)),
        joint("left_finger", "l3", "left_jaw", "prismatic", f'{at}<axis xyz="0 1 0"/>', limit),
        joint("right_finger", "l3", "right_jaw", "prismatic", f'{at}<axis xyz="0 -1 0"/>{mimic}', limit),
    )


def body(inertia: str) -> str:
    return f'{BOX}<inertial><mass value="1"/><inertia {inertia}/></inertial>'


REFUSED = {
    "missing package": (
        arm(base=link("base", collision('<mesh filename="package://arm_meshes/base.stl"/>'))),
        (":2: <mesh>: package://arm_meshes/base.stl not found", "--package arm_meshes=FOLDER"),
    ),
    "missing mesh": (
        arm(base=link("base", collision('<mesh filename="meshes/base.stl"/>'))),
        (":2: <mesh>: mesh file", "meshes/base.stl not found", "check the path"),
    ),
    "missing limit": (
        arm(first=joint("j1", "base", "l1", limit="")),
        (":4: <joint name='j1'>: a revolute joint needs <limit>", "add <limit lower="),
    ),
    "mesh in millimeters": (
        arm(base=link("base", collision('<mesh filename="big.obj"/>'))),
        (":2: <mesh>: mesh is 150 m large", 'add scale="0.001 0.001 0.001"'),
    ),
    "loop of joints": (
        arm(joint("back", "l3", "l2")),
        (
            ":9: <joint name='back'>: link 'l2' is the child of both 'j2' and 'back'",
            "cut the loop",
            "<mimic>",
        ),
    ),
    "no moving joint": ((link("base", BOX),), ("robot 'r' has no joint that moves", "revolute or prismatic")),
}


@pytest.fixture
def setup(tmp_path, capsys, caplog, monkeypatch):
    monkeypatch.setenv(XACRO_ARGS, "")
    monkeypatch.setenv(PACKAGES, "")
    (tmp_path / "big.obj").write_text(
        "v 0 0 0\nv 150 0 0\nv 0 150 0\nv 0 0 150\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    )

    def run(text: str, name: str = "r.urdf", status: int = 0) -> str:
        (tmp_path / name).write_text(text)
        said = call(capsys, "setup", tmp_path / name, "-o", tmp_path / "cell", "--samples", "200")
        assert said.status == status, said
        assert (tmp_path / "cell").exists() == (status == 0)
        return " ".join((said.out + said.err + caplog.text).split())  # armcell prints the log on stderr

    return run


@pytest.mark.parametrize(("elements", "words"), REFUSED.values(), ids=REFUSED)
def test_a_fault_that_stops_setup(setup, elements, words):
    said = setup(robot(*elements), status=1)
    for part in words:
        assert part in said


def test_a_missing_argument(setup):
    text = robot(*arm()).replace('name="r"', 'name="r$(arg dof)" xmlns:xacro="http://ros.org/wiki/xacro"')
    said = setup(text, "r.urdf.xacro", status=1)
    assert "r.urdf.xacro:1: " in said and "--xacro-arg dof:=VALUE" in said


def test_an_argument_without_a_default_and_a_macro_without_its_parameter(setup):
    head = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    said = setup(f'{head}\n<xacro:arg name="dof"/></robot>', "r.urdf.xacro", status=1)
    assert "r.urdf.xacro:2: " in said and "argument 'dof' has no default" in said
    assert '(add default="..."; --xacro-arg NAME:=VALUE overrides it)' in said
    macro = '<xacro:macro name="m" params="x y"><link name="${x}"/></xacro:macro>'
    said = setup(f'{head}\n{macro}\n<xacro:m x="a"/></robot>', "r.urdf.xacro", status=1)
    assert "r.urdf.xacro:3: " in said and "macro 'm' needs the parameters y (add y=\"...\")" in said


WARNED = {
    "degrees": (
        arm(first=joint("j1", "base", "l1", limit=LIMIT.format(-170, 170))),
        ("r.urdf:4: the limits of joint 'j1', -170 to 170 rad, look like degrees: use radians",),
    ),
    "limits in millimeters": (
        arm(first=joint("j1", "base", "l1", "prismatic", limit=LIMIT.format(0, 300))),
        ("r.urdf:4: the limits of joint 'j1', 0 to 300 m, look like millimeters: use meters",),
    ),
    "origin in millimeters": (
        arm(first=joint("j1", "base", "l1", inside='<origin xyz="0 0 330"/><axis xyz="0 0 1"/>')),
        ("r.urdf:4: the origin of <joint> j1, 0 0 330 m, looks like millimeters: use meters",),
    ),
    "rotation in degrees": (
        arm(first=joint("j1", "base", "l1", inside='<origin rpy="90 0 0"/><axis xyz="0 0 1"/>')),
        ("r.urdf:4: the rotation of <joint> j1, 90 0 0 rad, looks like degrees: use radians",),
    ),
    "limit without a range": (
        arm(first=joint("j1", "base", "l1", limit='<limit velocity="1" effort="50"/>')),
        ("r.urdf:4: joint 'j1' cannot move: lower and upper are both 0; set lower= and upper=",),
    ),
    "zero inertia": (
        arm(body=body('ixx="0" iyy="0" izz="0"')),
        ("r.urdf:3: the inertia of link 'l1' is zero", "check signs and units"),
    ),
    "left-handed inertia": (
        arm(body=body('ixx="0.01" iyy="0.01" izz="-0.01"')),
        ("r.urdf:3: the inertia of link 'l1' is not of a real body", "check signs and units"),
    ),
    "no gripper": (arm(), ("no gripper: nothing branches off or closes at l3", "docs/adding_a_gripper.md")),
    "jaws that cannot close": (
        arm(*hand(gap=0.05, upper=0.01)),
        ("its jaws close only to 90 mm, where joint left_finger is at its limit 0", "robot.yaml"),
    ),
    "jaws that cannot move": (
        arm(*hand(gap=0.02, upper=0.0)),
        ("joint left_finger cannot move: lower and upper limit are equal", "robot.yaml"),
    ),
    "linkage without mimic": (
        arm(*hand(gap=0.005, upper=0.03, mimic="")),
        ("2 driven joints (left_finger, right_finger), but one must move the jaws and the others mimic it",),
    ),
    "joint that no arm drives": (
        arm(link("head"), joint("pan", "base", "head")),
        ("in no group: pan",),
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize(("elements", "words"), WARNED.values(), ids=WARNED)
def test_a_fault_with_which_the_arm_can_still_move(setup, elements, words):
    said = setup(robot(*elements))
    for part in words:
        assert part in said
