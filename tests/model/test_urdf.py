"""What a URDF may say: joint types, defaults, shapes, colors, meshes, order."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from tests.model.helpers import collision, joint, link, model_of, robot

from armcell.core import Box, Capsule, Cylinder, Mesh, Sphere
from armcell.model import load_robot, load_urdf


def test_joints_are_depth_first_in_file_order():
    model = model_of(
        joint("b", "base", "lb"), joint("c", "base", "lc"), joint("b2", "lb", "lb2"), joint("a", "lb", "la"),
        *(link(n) for n in ("la", "lb", "lb2", "lc", "base")),
    )  # fmt: skip
    assert model.root_link == "base"
    assert model.joint_names == ("b", "b2", "a", "c")


def test_defaults_of_what_is_left_out():
    model = model_of(link("a"), link("b"), joint("j", "a", "b", inside="", limit="<limit/>"))
    found = model.joints["j"]
    assert found.axis == (1.0, 0.0, 0.0)
    np.testing.assert_array_equal(found.T_parent_joint.matrix, np.eye(4))
    assert (found.limits.lower, found.limits.upper) == (0.0, 0.0)
    assert (found.limits.velocity, found.limits.effort) == (np.inf, np.inf)  # 0 stands for "not given"
    assert model.links["a"].inertial is None and model.links["a"].collisions == ()


def test_an_axis_is_made_unit():
    model = model_of(link("a"), link("b"), joint("j", "a", "b", inside='<axis xyz="0 3 4"/>'))
    assert model.joints["j"].axis == pytest.approx((0.0, 0.6, 0.8))


def test_continuous_has_no_position_limits_but_keeps_its_speed():
    model = model_of(
        link("a"), link("b"), joint("j", "a", "b", "continuous", '<limit velocity="2" effort="3"/>')
    )
    limits = model.joints["j"].limits
    assert (limits.lower, limits.upper, limits.velocity, limits.effort) == (-np.inf, np.inf, 2.0, 3.0)
    model.check_positions([1000.0])


def test_mimic_joints_are_not_actuated():
    model = model_of(
        *(link(n) for n in "abcd"),
        joint("j", "a", "b"), joint("f", "a", "c", "fixed"),
        joint("m", "c", "d", inside='<mimic joint="j" multiplier="-0.5" offset="0.1"/>'),
    )  # fmt: skip
    assert model.joint_names == ("j",) and model.movable_joint_names == ("j", "m")
    assert (model.joints["m"].mimic.multiplier, model.joints["m"].mimic.offset) == (-0.5, 0.1)
    assert model.rigid_groups == (frozenset("ac"), frozenset("b"), frozenset("d"))


def test_planar_and_floating_become_single_joints():
    model = model_of(
        link("a"), link("b"), link("c"),
        joint("p", "a", "b", "planar", '<axis xyz="0 0 1"/>'), joint("f", "b", "c", "floating", ""),
    )  # fmt: skip
    assert model.joint_names == (
        "p/x", "p/y", "p/theta", "f/trans_x", "f/trans_y", "f/trans_z", "f/yaw", "f/pitch", "f/roll",
    )  # fmt: skip
    assert model.dof == 9 and set("abc") <= set(model.links)
    assert all(np.isinf(model.joints[n].limits.upper) for n in model.joint_names)


def test_every_primitive():
    (found,) = [
        model_of(
            link(
                "a",
                collision('<box size="1 2 3"/>') + collision('<sphere radius="0.5"/>')
                + collision('<cylinder radius="0.1" length="0.2"/>')
                + collision('<capsule radius="0.3" length="0.4"/>'),
            )
        ).links["a"].collisions
    ]  # fmt: skip
    assert [c.shape for c in found] == [Box(1, 2, 3), Sphere(0.5), Cylinder(0.1, 0.2), Capsule(0.3, 0.4)]


def test_colors_come_from_the_visual_or_by_name():
    def visual(material):
        return f'<visual><geometry><sphere radius="1"/></geometry>{material}</visual>'

    model = model_of(
        '<material name="red"><color rgba="1 0 0 1"/></material>',
        link(
            "a",
            visual('<material name="red"/>') + visual("")
            + visual('<material name="own"><color rgba="0 1 0 0.5"/></material>'),
        ),
    )  # fmt: skip
    assert [v.color for v in model.links["a"].visuals] == [(1, 0, 0, 1), None, (0, 1, 0, 0.5)]


def test_a_mesh_is_scaled_and_kept_whole(tmp_path):
    box = trimesh.creation.box((0.1, 0.2, 0.3))
    (tmp_path / "box.stl").write_bytes(box.export(file_type="stl"))
    file = tmp_path / "r.urdf"
    file.write_text(robot(link("a", collision('<mesh filename="box.stl" scale="1 2 0.5"/>'))))
    shape = load_urdf(file).links["a"].collisions[0].shape
    assert isinstance(shape, Mesh) and (len(shape.vertices), len(shape.faces)) == (8, 12)
    np.testing.assert_allclose(np.ptp(shape.vertices, axis=0), (0.1, 0.4, 0.15), atol=1e-7)


def test_inertia_is_symmetric():
    numbers = 'ixx="1" ixy="0.1" ixz="0.2" iyy="2" iyz="0.3" izz="3"'
    inertial = f'<inertial><origin xyz="1 2 3"/><mass value="4"/><inertia {numbers}/></inertial>'
    found = model_of(link("a", inertial)).links["a"].inertial
    assert found.mass == 4.0
    np.testing.assert_array_equal(found.inertia, [[1, 0.1, 0.2], [0.1, 2, 0.3], [0.2, 0.3, 3]])
    np.testing.assert_array_equal(found.T_link_com.translation, [1, 2, 3])


XACRO = """<robot name="snake" xmlns:xacro="http://www.ros.org/wiki/xacro">
  HERE
  <xacro:property name="size" value="0.5"/>
  <link name="s0"/>
  <xacro:segment parent="0" n="1"/><xacro:segment parent="1" n="2"/>
</robot>"""
SEGMENT = """<xacro:macro name="segment" params="parent n">
    <link name="s${n}"><collision><geometry><box size="${size} ${size/2} 0.1"/></geometry></collision></link>
    <joint name="j${n}" type="revolute"><parent link="s${parent}"/><child link="s${n}"/>
      <origin xyz="${size} 0 0"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="1" effort="1"/>
    </joint>
  </xacro:macro>"""


def write_snake(folder, name: str, include: bool):
    (folder / name).write_text(
        XACRO.replace("HERE", '<xacro:include filename="segment.xacro"/>' if include else SEGMENT)
    )
    (folder / "segment.xacro").write_text(
        f'<robot xmlns:xacro="http://www.ros.org/wiki/xacro">{SEGMENT}</robot>'
    )
    srdf = '<robot name="snake"><group name="g"><chain base_link="s0" tip_link="s2"/></group></robot>'
    (folder / "snake.srdf").write_text(srdf)


@pytest.mark.parametrize(
    ("name", "include"),
    [
        ("snake.urdf.xacro", False),
        ("snake.xacro", False),
        ("snake.urdf.xacro", True),
    ],
)
def test_xacro_is_expanded_and_its_srdf_found(tmp_path, name, include):
    write_snake(tmp_path, name, include)
    model = load_robot(tmp_path / name)
    assert (model.name, model.joint_names) == ("snake", ("j1", "j2"))
    assert model.links["s2"].collisions[0].shape == Box(0.5, 0.25, 0.1)
    assert model.groups["g"].joint_names == ("j1", "j2")


def test_a_robot_without_srdf_may_touch_at_its_joints(tmp_path):
    (tmp_path / "r.urdf").write_text(robot(link("a"), link("b"), joint("j", "a", "b")))
    model = load_robot(tmp_path / "r.urdf")
    assert dict(model.disabled_collisions) == {frozenset("ab"): "Adjacent"} and not model.groups
