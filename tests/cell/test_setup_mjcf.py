"""`armcell setup` of MJCF files of an arm with a gripper, as in MuJoCo Menagerie: groups, gripper, pick."""

from __future__ import annotations

import warnings

import pytest
import yaml
from tests.cell.starter import check_starter
from tests.cli.helpers import call

from armcell.kinematics import kinematic_tree
from armcell.model import load_robot
from armcell.model.setup.arm_detection import with_groups
from armcell.model.setup.gripper_detection import find_grippers

ARM = """<mujoco model="arm6">
  <compiler angle="radian"/>
  <default>
    <default class="link"><geom type="capsule" size="0.04" mass="1.5"/></default>
    <default class="servo"><position kp="2000" kv="200" forcerange="-150 150"/></default>
    <default class="bar"><joint armature="0.1" damping="0.1"/></default>
    <default class="soft"><joint type="slide" axis="0 1 0" stiffness="20000" damping="20"/></default>
    <default class="finger"><joint type="slide" axis="0 1 0" range="0 0.04" damping="5" armature="0.05"/>
      <geom type="box" size="0.012 0.008 0.03" pos="0 0.008 0.03" mass="0.05" friction="1"/></default>
  </default>
  <worldbody>
    <body name="base"><geom type="cylinder" size="0.07 0.05" pos="0 0 0.05" mass="5"/>
      <body name="shoulder" pos="0 0 0.15"><joint name="joint1" axis="0 0 1" range="-2.9 2.9"/>
        <geom class="link" fromto="0 0 0 0 0 0.1"/>
        <body name="upper" pos="0 0 0.15"><joint name="joint2" axis="0 1 0" range="-1.9 1.9"/>
          <geom class="link" fromto="0 0 0.06 0 0 0.3"/>
          <body name="fore" pos="0 0 0.36"><joint name="joint3" axis="0 1 0" range="-2.6 2.6"/>
            <geom class="link" fromto="0 0 0.06 0 0 0.2" size="0.035"/>
            <body name="wrist1" pos="0 0 0.27"><joint name="joint4" axis="0 0 1" range="-2.9 2.9"/>
              <geom class="link" fromto="0 0 0.01 0 0 0.05" size="0.03" mass="0.6"/>
              <body name="wrist2" pos="0 0 0.1"><joint name="joint5" axis="0 1 0" range="-2.2 2.2"/>
                <geom class="link" fromto="0 0 0 0 0 0.04" size="0.03" mass="0.5"/>
                <body name="wrist3" pos="0 0 0.09"><joint name="joint6" axis="0 0 1" range="-3 3"/>
                  <geom type="cylinder" size="0.03 0.01" mass="0.3"/>
                  <body name="hand" pos="0 0 0.01">
                    <geom type="box" size="0.03 0.06 0.02" pos="0 0 0.02" mass="0.4"/>{fingers}
                  </body></body></body></body></body></body></body></body>
  </worldbody>
  {coupling}
  <actuator>
    <position class="servo" joint="joint1"/><position class="servo" joint="joint2"/>
    <position class="servo" joint="joint3"/><position class="servo" joint="joint4"/>
    <position class="servo" joint="joint5"/><position class="servo" joint="joint6"/>
    {drive}
  </actuator>
</mujoco>"""
FINGERS = """
                    <body name="left_finger" pos="0 0 0.04" childclass="finger">
                      <joint name="left_joint"/><geom/></body>
                    <body name="right_finger" pos="0 0 0.04" quat="0 0 0 1" childclass="finger">
                      <joint name="right_joint"/><geom/></body>"""
# The bars inherit the armature of the arm, as those of Menagerie's xArm gripper do.
# Four bars per finger: a crank and a rocker carry the finger, which a connect equality closes.
SIDE = """
                    <body name="{s}_crank" pos="0 {y} 0.05">
                      <joint name="{s}_joint" class="bar" axis="{a} 0 0" range="0 0.8"/>
                      <geom type="capsule" size="0.005" fromto="0 0 0 0 {l} 0.04" mass="0.02"/>
                      <body name="{s}_finger" pos="0 {l} 0.04">
                        <joint name="{s}_coupler" class="bar" axis="{a} 0 0"/>
                        <geom type="box" size="0.011 0.006 0.03" pos="0 {f} 0.03" mass="0.05" friction="1"/>
                      </body></body>
                    <body name="{s}_rocker" pos="0 {r} 0.05">
                      <joint name="{s}_passive" class="bar" axis="{a} 0 0"/>
                      <geom type="capsule" size="0.004" fromto="0 0 0 0 {l} 0.04" mass="0.02"/></body>"""
LEFT = {"s": "left", "y": 0.045, "a": -1, "l": -0.03, "f": -0.006, "r": 0.06}
LINKAGE = SIDE.format(**LEFT) + SIDE.format(**{k: -v if k in "yalfr" else v for k, v in LEFT.items()}
                                            | {"s": "right"})  # fmt: skip
# As in Menagerie's 2F-85: with MuJoCo's default, the pads of a linkage tilt under the grip force.
STIFF = 'solref="0.005 1" solimp="0.95 0.99 0.001"'
CLOSE = f"""<equality>
  <connect body1="left_finger" body2="left_rocker" anchor="0 0.015 0" {STIFF}/>
  <connect body1="right_finger" body2="right_rocker" anchor="0 -0.015 0" {STIFF}/>
  <joint joint1="right_joint" joint2="left_joint" {STIFF}/></equality>"""
EQUALITY = '<equality><joint joint1="left_joint" joint2="right_joint" polycoef="0 1 0 0 0"/></equality>'
SPLIT = """<tendon><fixed name="split"><joint joint="left_joint" coef="0.5"/>
  <joint joint="right_joint" coef="0.5"/></fixed></tendon>"""

# Each finger consists of three bodies, and an MJCF joint that only a spring holds carries its pad.
PADS = FINGERS.replace(
    '_joint"/><geom/></body>',
    '_joint"/><geom size="0.012 0.004 0.01" pos="0 0.012 0.01"/>'
    '<body pos="0 0 0.02"><geom size="0.011 0.003 0.02" pos="0 0.012 0.02" mass="0.02"/>'
    '<body><joint class="soft"/><geom size="0.012 0.004 0.02" pos="0 0.005 0.02" mass="0.02"/></body></body>'
    "</body>",
)

GRIP = 'name="grip" kp="1000" forcerange="-60 60"'
HANDS = {  # fingers, their coupling, what the gripper's actuator moves, opening [m], its tolerance
    "equality": (FINGERS, EQUALITY, 'joint="left_joint"', 0.08, 1e-3),
    "tendon": (FINGERS, SPLIT, 'tendon="split"', 0.08, 1e-3),
    "equality and tendon": (FINGERS, EQUALITY + SPLIT, 'tendon="split"', 0.08, 1e-3),
    "parts": (PADS, EQUALITY, 'joint="left_joint"', 0.082, 1e-3),
    "closed linkage": (LINKAGE, CLOSE, 'joint="left_joint"', 0.082, 3e-3),
}


# A slider carries both fingers and opens them, as in Hello Robot's Stretch.
SLIDER = """
                    <body name="slider" pos="0 0 0.05">
                      <joint name="grip_slide" type="slide" axis="0 0 1" range="0 0.03" armature="0.1"/>
                      <inertial pos="0 0 0" mass="0.05" diaginertia="1e-5 1e-5 1e-5"/>
                      <body name="left_finger" pos="0 0.005 0">
                        <joint name="left_open" axis="-1 0 0" range="0 0.3"/>
                        <geom type="box" size="0.01 0.004 0.04" pos="0 0.004 0.05" mass="0.05"/></body>
                      <body name="right_finger" pos="0 -0.005 0">
                        <joint name="right_open" axis="1 0 0" range="0 0.3"/>
                        <geom type="box" size="0.01 0.004 0.04" pos="0 -0.004 0.05" mass="0.05"/>
                      </body></body>"""
SLIDES = """<equality><joint joint1="left_open" joint2="grip_slide" polycoef="0 10 0 0 0"/>
  <joint joint1="right_open" joint2="grip_slide" polycoef="0 10 0 0 0"/></equality>"""
# The tips of the fingers are on one side of the hand, as in I2RT's YAM.
LOPSIDED = FINGERS.replace("<geom/>", '<geom pos="{x} 0.008 0.03"/>')
LOPSIDED = LOPSIDED.replace("{x}", "0.008", 1).replace("{x}", "-0.008", 1)
# One jaw turns by 95 degrees; around its joint, both links overlap in every position.
ONE_JAW = """
                    <body name="fixed_jaw" pos="0 0 0.04">
                      <geom type="box" size="0.01 0.02 0.025" pos="0 0.01 0.02"/>
                      <geom type="box" size="0.01 0.004 0.025" pos="0 -0.006 0.045"/>
                      <body name="jaw" pos="0 0.02 0.03"><joint name="jaw" axis="-1 0 0" range="-0.03 1.6"/>
                        <geom type="box" size="0.008 0.012 0.012"/>
                        <geom type="box" size="0.01 0.004 0.025" pos="0 -0.018 0.015"/></body></body>"""


@pytest.mark.parametrize(
    ("fingers", "coupling", "drive", "widest"),
    [
        (SLIDER, SLIDES, "grip_slide", 0.04),
        (LOPSIDED, EQUALITY, "left_joint", 0.08),
        (ONE_JAW, "", "jaw", 0.02),
    ],
    ids=["slider", "lopsided", "one jaw"],
)
def test_hands_of_menagerie_are_grippers(tmp_path, fingers, coupling, drive, widest):
    model = load_robot(written(tmp_path, fingers, coupling, f'joint="{drive}"'))
    model = find_grippers(with_groups(model), tips=True)
    assert model.groups["arm"].joint_names == tuple(f"joint{i}" for i in range(1, 7))
    gripper, tree, q = model.gripper(), kinematic_tree(model), model.default_positions()
    assert gripper.joint_name == drive and gripper.max_width >= widest
    T = tree.link_pose(q, "hand").inverse() @ tree.link_pose(q, gripper.tcp_link)
    least = 0.9 if drive == "jaw" else 1 - 1e-9  # a turning jaw tilts the hand
    assert T.rotation.matrix[2, 2] > least and 0.05 < T.translation[2] < 0.14


def test_fingers_of_one_driven_joint_are_a_gripper_without_an_arm(tmp_path):
    """Their names need not be typical for jaws, as in Menagerie's 2F-85."""
    file = tmp_path / "hand.xml"
    parts = "".join(
        f'<body name="{s}_driver"><joint name="{s}" type="slide" axis="0 1 0" range="0 0.1"/>'
        f'<geom type="box" size=".01 .01 .01" pos="0 {y} 0"/></body>'
        for s, y in (("a", 0.1), ("b", -0.1))
    )
    file.write_text(
        f'<mujoco><worldbody><body name="base"><geom size=".02"/>{parts}</body></worldbody><equality>'
        '<joint joint1="b" joint2="a" polycoef="0 -1 0 0 0"/></equality></mujoco>'
    )
    model = with_groups(load_robot(file))
    assert list(model.groups) == ["gripper"] and model.groups["gripper"].joint_names == ("a",)


@pytest.fixture(params=HANDS)
def hand(request):
    return HANDS[request.param]


def written(folder, fingers: str, coupling: str, drive: str):
    file = folder / "arm6.xml"
    file.write_text(ARM.format(fingers=fingers, coupling=coupling, drive=f"<position {GRIP} {drive}/>"))
    return file


@pytest.mark.slow
@pytest.mark.cases("tendon", "parts", "closed linkage")
def test_an_arm_with_coupled_fingers_picks_and_places(hand, tmp_path, capsys, caplog):
    *parts, opening, tolerance = hand
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a user would see a library's warning
        said = call(capsys, "setup", written(tmp_path, *parts), "-o", tmp_path / "cell", "--samples", "2000")
    assert said.status == 0, said.err
    assert "holds a cube" in said.words and "gripper.png" in said.words
    model = load_robot(tmp_path / "cell")
    assert model.groups["arm"].joint_names == tuple(f"joint{i}" for i in range(1, 7))
    gripper, tree = model.gripper(), kinematic_tree(model)
    assert gripper.joint_name == "left_joint"
    assert {n.removesuffix("_child_child") for n in gripper.finger_links} == {"left_finger", "right_finger"}
    assert gripper.max_width == pytest.approx(opening, abs=tolerance)
    # The robot is the MJCF file, so physics keeps its couplings; ROS gets a URDF with mimic joints.
    assert yaml.safe_load((tmp_path / "cell/robot.yaml").read_text())["mjcf"].endswith("arm6.xml")
    assert model.mjcf and load_robot(tmp_path / "cell/config/arm6.urdf").joint_names == model.joint_names
    q, apart = model.default_positions(), []
    for width in (0.02, 0.06):  # both fingers move, toward each other
        q[model.columns(gripper.joint_names)] = gripper.joint_position(width)
        T = tree.link_pose(q, gripper.tcp_link).inverse()
        left, right = ((T @ tree.link_pose(q, name)).translation[1] for name in gripper.finger_links)
        assert left == pytest.approx(-right, abs=1e-3)
        apart.append(abs(left - right))
    assert apart[1] - apart[0] == pytest.approx(0.04, abs=1e-3)
    check_starter(tmp_path / "cell")


@pytest.mark.slow
def test_an_arm_with_soft_servos_and_friction_picks_and_places(tmp_path, capsys):
    *parts, _, _ = HANDS["tendon"]
    file = written(tmp_path, *parts)
    soft = file.read_text().replace('kp="2000" kv="200"', 'kp="60" kv="12"')
    file.write_text(soft.replace("<default>", '<default><joint frictionloss="0.6"/>', 1))
    said = call(capsys, "setup", file, "-o", tmp_path / "cell", "--samples", "2000")
    assert said.status == 0, said.err
    text = (tmp_path / "cell/cell.yaml").read_text()
    assert "goal_tolerance: 0.0" in text and "servos are soft" in text
    check_starter(tmp_path / "cell")


@pytest.mark.slow
def test_fingers_with_an_actuator_each_move_together(tmp_path, capsys):
    """As in Menagerie's TIAGo: setup writes an MJCF file with the coupling."""
    file = written(tmp_path, FINGERS, "", 'joint="right_joint"')
    two = '<position name="other" kp="1000" joint="left_joint"/></actuator>'
    file.write_text(file.read_text().replace("</actuator>", two))
    said = call(capsys, "setup", file, "-o", tmp_path / "alone", "--samples", "2000")
    assert said.status == 0 and "drive=JOINT follower=JOINT" in said.words
    words = "drive=right_joint follower=left_joint"
    said = call(capsys, "setup", file, "-o", tmp_path / "cell", "--samples", "2000", "--gripper", words)
    assert said.status == 0 and "holds a cube" in said.words, said.err
    model = load_robot(tmp_path / "cell")
    mimic = model.joints["left_joint"].mimic
    assert mimic is not None and (mimic.joint, mimic.multiplier, mimic.offset) == ("right_joint", 1.0, 0.0)
    assert model.gripper().joint_name == "right_joint"
    assert yaml.safe_load((tmp_path / "cell/robot.yaml").read_text())["mjcf"] == "config/arm6.mjcf"
    check_starter(tmp_path / "cell")
