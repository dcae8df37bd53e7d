"""Robots from MJCF keep their own physical parameters, servos and couplings in physics."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from tests.model.test_mjcf import DRIVE, JAWS, LINKAGE, TENDON, arm

from armcell.core import SE3, SO3, Box, Cylinder
from armcell.model import Gripper, MountedRobot, compose, load_robot
from armcell.scene import CollisionObject, PlanningScene
from armcell.sim import SimWorld
from armcell.sim.mujoco_model import build


def written(tmp_path, text):
    (tmp_path / "robot.xml").write_text(text)
    return load_robot(tmp_path / "robot.xml")


def scene_of(model):
    return PlanningScene(model, model.default_positions())


def test_bodies_keep_inertia_damping_and_contacts(tmp_path):
    file = arm(tmp_path)
    file.write_text(
        file.read_text().replace(
            '<geom type="mesh"', '<geom friction="0.3" solref="0.01 1" condim="6" type="mesh"'
        )
    )
    built = build(scene_of(load_robot(file))).mj
    reference = mujoco.MjModel.from_xml_path(str(file))
    for name in ("base", "upper", "fore"):
        ours, theirs = built.body(name), reference.body(name)
        assert ours.mass == pytest.approx(theirs.mass) and ours.inertia == pytest.approx(theirs.inertia)
        assert ours.ipos == pytest.approx(theirs.ipos)
    for name in ("pan", "lift", "elbow"):
        ours, theirs = built.joint(name), reference.joint(name)
        assert np.allclose(ours.damping, theirs.damping) and np.allclose(ours.range, theirs.range)
        assert np.allclose(ours.qpos0, theirs.qpos0)
    geom = next(i for i in range(built.ngeom) if built.geom_condim[i] == 6)
    assert built.geom_friction[geom, 0] == 0.3 and built.geom_solref[geom, 0] == 0.01


@pytest.mark.parametrize("visuals", [False, True])
def test_kinematics_in_physics_equal_the_models(tmp_path, visuals):
    from armcell.kinematics import kinematic_tree

    model = load_robot(arm(tmp_path))
    both = compose(
        "two", [MountedRobot(model, "a_", T_parent_root=SE3.from_xyz(0, 1, 0.2)), MountedRobot(model, "b_")]
    )
    built = build(scene_of(both), visuals=visuals)
    data = mujoco.MjData(built.mj)
    q = np.array([0.4, -0.3, 0.1, -0.6, 0.8, -0.05])
    data.qpos[built.qpos] = q
    mujoco.mj_kinematics(built.mj, data)
    tree = kinematic_tree(both)
    for name in ("a_upper", "a_fore", "a_tool", "b_base", "b_tool"):
        assert np.allclose(data.xpos[built.body[name]], tree.link_pose(q, name).translation, atol=1e-9)


def test_a_servo_keeps_its_gains_and_force_limit(tmp_path):
    built = build(scene_of(load_robot(arm(tmp_path)))).mj
    lift = built.actuator("lift")
    assert lift.biasprm[1:3].tolist() == [-1200.0, -80.0] and lift.forcerange.tolist() == [-80.0, 80.0]
    assert built.actuator("elbow").forcerange.tolist() == [-15.0, 15.0]  # a motor gets armcell's servo


def test_the_arm_follows_a_target(tmp_path):
    model = load_robot(arm(tmp_path))
    world = SimWorld(scene_of(model))
    goal = np.array([0.3, 0.1, 0.02])
    world.set_arm_target(model.joint_names, goal)
    world.step(2000)
    assert np.allclose(world.joint_state().positions, goal, atol=5e-3)


@pytest.mark.parametrize(
    "text", [JAWS.format(TENDON + DRIVE + '<equality><joint joint1="r" joint2="l"/></equality>')]
)
def test_coupled_fingers_move_together(tmp_path, text):
    model = written(tmp_path, text)
    world = SimWorld(scene_of(model))
    world.set_arm_target(("l",), [0.03])
    world.step(1500)
    at = world.built.joint_qpos
    assert world._data.qpos[at["l"]] == pytest.approx(0.03, abs=2e-3)
    assert world._data.qpos[at["r"]] == pytest.approx(world._data.qpos[at["l"]], abs=1e-3)


def test_a_linkage_stays_closed_and_follows_the_planners_rule(tmp_path):
    model = written(tmp_path, LINKAGE)
    world = SimWorld(scene_of(model))
    world.set_arm_target(("crank",), [0.5])
    world.step(2000)
    at, qpos = world.built.joint_qpos, world._data.qpos
    assert qpos[at["crank"]] == pytest.approx(0.5, abs=0.02)
    for name in ("rocker", "coupler"):
        mimic = model.joints[name].mimic
        assert qpos[at[name]] == pytest.approx(mimic.multiplier * qpos[at["crank"]] + mimic.offset, abs=0.02)


def test_a_hand_with_springs_and_friction_reaches_its_width(tmp_path):
    """A gripper's motor overcomes what the joints of its hand resist."""
    text = JAWS.replace(
        'range="0 0.04"', 'range="0 0.04" frictionloss="4" damping="3000" stiffness="60" springref="-0.05"'
    )
    model = written(
        tmp_path, text.format(TENDON + DRIVE + '<equality><joint joint1="r" joint2="l"/></equality>')
    )
    gripper = Gripper(
        name="hand", arm_group="none", group="none", joint_name="l", tcp_link="palm",
        finger_links=("left", "right"), hand_links=("palm", "left", "right"),
    )  # fmt: skip
    world = SimWorld(scene_of(replace(model, grippers={"hand": gripper})))
    for width in (0.07, 0.02, 0.05):
        world.set_gripper_target("hand", width)
        world.step(1000)
        assert world.gripper_state("hand").width == pytest.approx(width, abs=1e-3)


@pytest.mark.parametrize(
    ("masks", "pairs"),
    [
        ('contype="0" conaffinity="1"', ""),
        ('contype="0" conaffinity="3"', ""),
        ('contype="2" conaffinity="4"', ""),
        ('contype="0" conaffinity="0"', '<contact><pair geom1="plate" geom2="jaw"/></contact>'),
    ],
)
def test_objects_rest_on_links_with_any_contact_mask(tmp_path, masks, pairs):
    """MJCF files may restrict which geoms of a robot touch each other; objects touch all of them."""
    plate = f'<geom name="plate" type="box" size="0.2 0.2 0.01" pos="0 0 -0.1" {masks}/>'
    text = JAWS.replace('<geom size="0.03"/>', plate).replace(
        '<geom size="0.01"/>', '<geom name="jaw" size="0.01"/>', 1
    )
    model = written(tmp_path, text.format(TENDON + DRIVE + pairs))
    cube = CollisionObject.single("cube", Box(0.04, 0.04, 0.04), SE3.from_xyz(0.1, 0, -0.068), movable=True)
    world = SimWorld(scene_of(model).with_object(cube))
    world.step(300)
    assert world.object_poses()["cube"].translation[2] == pytest.approx(-0.07, abs=1e-3)


def test_a_can_between_recessed_pads_is_pressed_along_the_closing_direction(tmp_path):
    """MuJoCo 4.0 computes normals along the boxes' first axes where a can touches their edges. The files of
    Menagerie state pads such as these, and boxes in rotated frames.
    """
    pads = "".join(
        f'<frame pos="{x} 0.002 0" euler="0 0 180"><geom type="box" size="0.003 0.002 0.01"/></frame>'
        for x in (-0.0055, 0.0055)
    )
    text = JAWS.replace('axis="0 -1 0"', 'axis="0 1 0"').replace('<geom size="0.01"/>', pads)
    text = text.replace('<body name="right">', '<body name="right" quat="0 0 0 1">')
    text = text.replace('<geom size="0.03"/>', '<geom size="0.01" pos="0 0 -0.1"/>')
    model = written(
        tmp_path, text.format('<equality><joint joint1="r" joint2="l"/></equality>' + TENDON + DRIVE)
    )
    gripper = Gripper(
        name="hand", arm_group="none", group="none", joint_name="l", tcp_link="palm",
        finger_links=("left", "right"), hand_links=("palm", "left", "right"),
    )  # fmt: skip
    can = CollisionObject.single("can", Cylinder(0.024, 0.08), movable=True, mass=0.1)
    pressed = np.sqrt(0.024**2 - 0.0025**2) - 1e-4  # the can overlaps the inner edges of the boxes
    scene = PlanningScene(replace(model, grippers={"hand": gripper}), np.array([pressed])).with_object(can)
    mj = build(scene).mj
    reference = mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml"))
    for name in ("left", "right"):  # the boxes are those of the file
        shapes = [
            {
                tuple(np.round(m.geom_pos[g] + m_axis, 9))
                for g in range(m.ngeom) if m.geom_bodyid[g] == m.body(name).id
                for m_axis in _corners(m.geom_quat[g], m.geom_size[g])
            }
            for m in (mj, reference)
        ]  # fmt: skip
        assert shapes[0] == shapes[1]
    data = mujoco.MjData(mj)
    data.joint("l").qpos = data.joint("r").qpos = pressed
    mujoco.mj_forward(mj, data)
    normals = np.array([contact.frame[:3] for contact in data.contact])
    assert len(normals) >= 4 and (np.abs(normals[:, 1]) > 0.9).all()


def _corners(quat_wxyz, size):
    """Corners (8, 3) of a box around its center."""
    signs = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T
    return signs * size @ SO3.from_quat_wxyz(quat_wxyz).matrix.T
