"""Every broken URDF is one clear line: file, line or element, reason."""

from __future__ import annotations

import pytest
from tests.model.helpers import collision, joint, link, robot

from armcell.core import InputError
from armcell.kinematics import kinematic_tree
from armcell.model import load_robot

AB = (link("a"), link("b"))
LIMITED = '<limit lower="{}" upper="{}" velocity="1" effort="1"/>'


def sized(geometry: str) -> tuple[str]:
    return (link("a", collision(geometry)),)


def inertial(inside: str) -> tuple[str]:
    return (link("a", f"<inertial>{inside}</inertial>"),)


# elements, the line or the element that must be named, the reason
BAD = {
    "no links": ((), ":1: <robot name='r'>", "has no <link>"),
    "duplicate link": ((link("a"), link("a")), ":3: <link name='a'>", "a second link of this name"),
    "duplicate joint": (
        (*AB, link("c"), joint("j", "a", "b"), joint("j", "b", "c")),
        ":6: <joint name='j'>",
        "a second joint of this name",
    ),
    "nameless link": (("<link/>",), ":2: <link>", "attribute 'name' is missing"),
    "two roots": (AB, "2 root links (a, b)", "exactly one is needed"),
    "loop": ((*AB, joint("j", "a", "b"), joint("k", "b", "a")), "loop", "no root link"),
    "loop apart": (
        (*AB, link("c"), joint("j", "a", "b"), joint("k", "b", "a")),
        "joints j, k",
        "form a loop apart from the root",
    ),
    "own parent": ((*AB, joint("j", "a", "a")), "joints j", "loop"),
    "two parents": (
        (*AB, link("c"), joint("j", "a", "c"), joint("k", "b", "c")),
        "link 'c'",
        "is the child of both 'j' and 'k'",
    ),
    "unknown parent": (
        (*AB, joint("j", "x", "b")),
        ":4: <joint name='j'>",
        "parent link 'x' does not exist",
    ),
    "unknown child": ((*AB, joint("j", "a", "x")), ":4: <joint name='j'>", "child link 'x' does not exist"),
    "no parent": (
        (*AB, '<joint name="j" type="fixed"><child link="b"/></joint>'),
        ":4: <joint name='j'>",
        "has no <parent>",
    ),
    "unknown type": ((*AB, joint("j", "a", "b", "hinge")), ":4: <joint", "unknown joint type 'hinge'"),
    "zero axis": ((*AB, joint("j", "a", "b", inside='<axis xyz="0 0 0"/>')), ":4: <axis>", "length zero"),
    "short axis": (
        (*AB, joint("j", "a", "b", inside='<axis xyz="0 1"/>')),
        ":4: <axis>",
        "xyz='0 1' must be 3 finite numbers",
    ),
    "crossed limits": (
        (*AB, joint("j", "a", "b", limit=LIMITED.format(1, -1))),
        ":4: <limit>",
        "lower 1 is above upper -1",
    ),
    "no limit": ((*AB, joint("j", "a", "b", limit="")), ":4: <joint", "a revolute joint needs <limit>"),
    "nan limit": (
        (*AB, joint("j", "a", "b", limit=LIMITED.format("nan", 1))),
        ":4: <limit>",
        "must be 1 finite number",
    ),
    "wordy limit": (
        (*AB, joint("j", "a", "b", limit=LIMITED.format("low", 1))),
        ":4: <limit>",
        "is not a list of numbers",
    ),
    "nan origin": (
        (*AB, joint("j", "a", "b", inside='<origin xyz="0 nan 0"/>')),
        ":4: <origin>",
        "must be 3 finite numbers",
    ),
    "mimics nothing": (
        (*AB, joint("j", "a", "b", inside='<mimic joint="x"/>')),
        "joint 'j'",
        "mimics unknown joint 'x'",
    ),
    "negative mass": (inertial('<mass value="-1"/>'), ":2: <mass>", "mass -1 kg is negative"),
    "nan mass": (inertial('<mass value="nan"/>'), ":2: <mass>", "must be 1 finite number"),
    "no mass": (inertial(""), ":2: <inertial>", "has no <mass>"),
    "zero box": (sized('<box size="0.1 0 0.1"/>'), ":2: <box>", "box has y 0, it must be a positive number"),
    "nan box": (sized('<box size="0.1 nan 0.1"/>'), ":2: <box>", "must be 3 finite numbers"),
    "negative sphere": (sized('<sphere radius="-1"/>'), ":2: <sphere>", "sphere has radius -1"),
    "no radius": (sized('<cylinder length="1"/>'), ":2: <cylinder>", "must be 1 finite number"),
    "unknown shape": (sized('<torus radius="1"/>'), ":2: <torus>", "unknown geometry"),
    "no shape": (sized(""), ":2: <collision>", "has no <geometry>"),
    "missing mesh": (sized('<mesh filename="no.stl"/>'), ":2: <mesh>", "no.stl not found"),
    "flat mesh": (sized('<mesh filename="no.stl" scale="1 0 1"/>'), ":2: <mesh>", "mesh scale has a zero"),
    "colour": (('<material name="m"><color rgba="1 1"/></material>',), ":2: <color>", "4 finite numbers"),
}  # fmt: skip


@pytest.mark.parametrize(("elements", "place", "reason"), BAD.values(), ids=BAD)
def test_a_broken_urdf(tmp_path, elements, place, reason):
    file = tmp_path / "bad.urdf"
    file.write_text(robot(*elements))
    with pytest.raises(InputError) as error:
        load_robot(file)
    text = str(error.value)
    assert text.startswith(f"{file}:") and place in text and reason in text and "\n" not in text


@pytest.mark.parametrize(
    ("type", "mimicked"),
    [
        ("revolute", "j"),
        ("revolute", "k"),
        ("fixed", "f"),
    ],
)
def test_a_mimic_must_follow_a_joint_that_is_driven(tmp_path, within, type, mimicked):
    """Not itself, not one that follows it, not a fixed one."""
    file = tmp_path / "bad.urdf"
    file.write_text(
        robot(
            *AB, link("c"), link("d"), joint("f", "a", "d", "fixed", ""),
            joint("j", "a", "b", inside=f'<mimic joint="{mimicked}"/>'),
            joint("k", "b", "c", inside='<mimic joint="j"/>'),
        )
    )  # fmt: skip
    with within(10), pytest.raises(InputError, match="mimic"):
        kinematic_tree(load_robot(file))
