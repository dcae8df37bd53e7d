"""Every broken URDF is one clear line: file, line or element, reason."""

from __future__ import annotations

import pytest
from tests.model.helpers import collision, joint, link, model_of, robot

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
    "loop": (
        (*AB, joint("j", "a", "b"), joint("k", "b", "a")),
        ":4: <joint name='j'>",
        "joints j, k form a loop and no link is the root (remove the joint that closes the loop)",
    ),
    "loop with a branch": (
        (link("x"), *AB, joint("i", "b", "x"), joint("j", "a", "b"), joint("k", "b", "a")),
        ":6: <joint name='j'>",
        "joints j, k form a loop and no link is the root",
    ),
    "loop apart": (
        (*AB, link("c"), joint("j", "a", "b"), joint("k", "b", "a")),
        ":5: <joint name='j'>",
        "joints j, k form a loop apart from the root",
    ),
    "own parent": ((*AB, joint("j", "a", "a")), ":4: <joint name='j'>", "loop"),
    "two parents": (
        (*AB, link("c"), joint("j", "a", "c"), joint("k", "b", "c")),
        ":6: <joint name='k'>",
        "link 'c' is the child of both 'j' and 'k'",
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
        ":4: <joint name='j'>",
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
    "color": (('<material name="m"><color rgba="1 1"/></material>',), ":2: <color>", "4 finite numbers"),
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


def test_faults_of_units_and_inertia_are_reported_with_their_line(tmp_path, caplog):
    body = '<inertial><mass value="1"/><inertia ixx="1" iyy="0.1" izz="0.1"/></inertial>'
    limit = '<limit lower="-170" upper="170" velocity="1" effort="1"/>'
    model_of(link("a"), link("b", body), joint("j", "a", "b", limit=limit))
    assert ":3: the inertia of link 'b' is not of a real body" in caplog.text
    assert ":4: the limits of joint 'j', -170 to 170 rad, look like degrees" in caplog.text


def test_a_mesh_in_millimeters_is_refused(tmp_path):
    (tmp_path / "big.obj").write_text(
        "v 0 0 0\nv 150 0 0\nv 0 150 0\nv 0 0 150\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    )
    with pytest.raises(InputError, match=r':2: .*mesh is 150 m large.*scale="0.001 0.001 0.001"'):
        model_of(link("a", collision('<mesh filename="big.obj"/>')), file=tmp_path / "r.urdf")


def test_a_closed_linkage_names_the_joint_and_mimic():
    with pytest.raises(InputError, match=r":6: .*child of both 'j' and 'k'.*<mimic>"):
        model_of(link("a"), link("b"), link("c"), joint("j", "a", "b"), joint("k", "c", "b"))
