"""MJCF models as robot models, against MuJoCo's own kinematics."""

from __future__ import annotations

import logging
from pathlib import Path

import mujoco
import numpy as np
import pytest

from armcell.core import InputError
from armcell.kinematics import kinematic_tree
from armcell.model import MountedRobot, compose, load_robot
from armcell.model.mjcf import load_mjcf

ROBOTS = Path(__file__).parents[3].joinpath("shared", "data", "robots").resolve()
TETRA = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"

# Degrees, nested defaults, anchors off the origin, two joints in a body, ref, a base with a pose.
ARM = """<mujoco model="arm">
  <compiler angle="degree" meshdir="meshes" eulerseq="ZYX"/>
  <default>
    <geom size="0.02"/>
    <default class="bar"><geom type="capsule" fromto="0 0 0 0 0 0.2"/></default>
    <default class="joint"><joint axis="0 1 0" range="-120 100" damping="2"/></default>
    <default class="servo"><position kp="300" kv="20" forcerange="-40 40"/></default>
  </default>
  <asset><mesh name="tip" file="tip.obj" scale="0.1 0.1 0.2"/></asset>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <light pos="0 0 3"/>
    <body name="base" pos="0.1 0 0.05" euler="30 0 10">
      <geom class="bar"/>
      <body name="upper" pos="0 0 0.2" childclass="joint">
        <joint name="pan" axis="0 0 1"/>
        <joint name="lift" pos="0.01 0 0.03" ref="15"/>
        <geom class="bar"/>
        <frame pos="0 0 0.2" euler="0 20 0">
          <body name="fore">
            <joint name="elbow" type="slide" axis="1 0 1" range="-0.1 0.2"/>
            <geom type="mesh" mesh="tip" pos="0 0.1 0" euler="0 0 40"/>
            <site name="tool" pos="0 0 0.3" euler="0 90 0"/>
          </body>
        </frame>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position class="servo" joint="pan"/>
    <position class="servo" joint="lift" gear="2"/>
    <motor joint="elbow" ctrlrange="-5 5" ctrllimited="true" gear="3"/>
  </actuator>
  <keyframe><key name="up" qpos="0.1 0.2 0.05"/></keyframe>
</mujoco>"""

# Two jaws, of which one follows the other in reverse, as in most parallel grippers.
JAWS = """<mujoco model="jaws"><worldbody><body name="palm"><geom size="0.03"/>
  <body name="left"><joint name="l" type="slide" axis="0 1 0" range="0 0.04"/><geom size="0.01"/></body>
  <body name="right"><joint name="r" type="slide" axis="0 -1 0" range="0 0.04"/><geom size="0.01"/></body>
</body></worldbody>{}</mujoco>"""
TENDON = '<tendon><fixed name="t"><joint joint="l" coef="1"/><joint joint="r" coef="1"/></fixed></tendon>'
EXCLUDE = '<contact><exclude body1="base" body2="fore"/></contact>'
BACK = 'joint="r" coef="1"', 'joint="r" coef="-1"'
DRIVE = '<actuator><position tendon="t" kp="100" forcerange="-20 20"/></actuator>'

# A parallelogram: the crank drives the rocker by a coupler that a connect equality closes.
LINKAGE = """<mujoco model="linkage"><compiler angle="radian"/><worldbody><body name="base">
  <geom size=".01"/>
  <body name="crank"><joint name="crank" axis="0 1 0" range="-0.8 0.8"/><geom size=".01" pos="0 0 .1"/>
    <body name="coupler" pos="0 0 .1"><joint name="coupler" axis="0 1 0"/><geom size=".01"/></body>
  </body>
  <body name="rocker" pos=".2 0 0"><joint name="rocker" axis="0 1 0"/><geom size=".01" pos="0 0 .1"/></body>
</body></worldbody>
<equality><connect body1="coupler" body2="rocker" anchor=".2 0 0"/></equality>
<contact><exclude body1="coupler" body2="rocker"/></contact>
<actuator><position joint="crank" kp="50"/></actuator></mujoco>"""


def arm(tmp_path: Path, text: str = ARM) -> Path:
    (tmp_path / "meshes").mkdir(exist_ok=True)
    (tmp_path / "meshes" / "tip.obj").write_text(TETRA)
    (tmp_path / "arm.xml").write_text(text)
    return tmp_path / "arm.xml"


def largest_difference(file: Path, samples: int = 20) -> float:
    """The largest difference of a body's or site's pose between our kinematics and MuJoCo's."""
    model = load_mjcf(file)
    tree, rng = kinematic_tree(model), np.random.default_rng(0)
    reference = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(reference)
    low = np.where(np.isfinite(model.lower), model.lower, -3.0)
    high = np.where(np.isfinite(model.upper), model.upper, 3.0)
    worst, compared = 0.0, 0
    for _ in range(samples):
        q = rng.uniform(low, high)
        data.qpos[:] = reference.qpos0
        for name, value in tree.full_positions(q).items():
            data.qpos[reference.joint(name).qposadr[0]] = value
        mujoco.mj_kinematics(reference, data)
        bodies = [(reference.body(i).name, data.xpos[i], data.xmat[i]) for i in range(1, reference.nbody)]
        sites = [
            (reference.site(i).name, data.site_xpos[i], data.site_xmat[i]) for i in range(reference.nsite)
        ]
        for name, position, rotation in (*bodies, *sites):
            if name not in model.links:
                continue
            T = tree.link_pose(q, name).matrix
            worst = max(worst, abs(T[:3, 3] - position).max(), abs(T[:3, :3].ravel() - rotation).max())
            compared += 1
    assert compared
    return worst


def test_kinematics_equal_mujocos(tmp_path):
    assert largest_difference(arm(tmp_path)) < 1e-9


@pytest.mark.slow
@pytest.mark.cases("kuka*")
@pytest.mark.parametrize(
    "file",
    ["kuka_iiwa_14/iiwa14.xml", "kuka_iiwa_14/scene.xml", "so101/Simulation/SO101/so101_new_calib.xml"],
)
def test_kinematics_of_published_models(file):
    if not (ROBOTS / file).is_file():
        pytest.skip("no shared data")
    assert largest_difference(ROBOTS / file) < 1e-9


def test_joints_servos_and_limits(tmp_path):
    model = load_mjcf(arm(tmp_path))
    assert model.joint_names == ("pan", "lift", "elbow")
    assert model.root_link == "arm_world"  # the base has a pose in the world
    lift = model.joints["lift"]
    assert lift.servo is not None and (lift.servo.kp, lift.servo.kv) == (1200.0, 80.0)  # gear 2
    assert lift.limits.effort == 80.0
    assert (lift.limits.lower, lift.limits.upper) == pytest.approx((np.radians(-120), np.radians(100)))
    assert model.joints["elbow"].servo is None and model.joints["elbow"].limits.effort == 15.0
    assert lift.damping == 2.0


def test_a_mesh_is_scaled_and_collides_as_its_hull(tmp_path):
    model = load_mjcf(arm(tmp_path))
    (solid,) = model.links["fore"].collisions
    T = solid.T_link_shape
    points = T.apply(solid.shape.vertices)
    z = np.radians(40)
    R = np.array([[1, 0, 0], [0, np.cos(z), -np.sin(z)], [0, np.sin(z), np.cos(z)]])  # eulerseq ZYX
    wanted = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.2]]) @ R.T + [0, 0.1, 0]
    assert sorted(np.round(points, 6).tolist()) == sorted(np.round(wanted, 6).tolist())
    (visual,) = model.links["fore"].visuals
    assert visual.file == tmp_path / "meshes" / "tip.obj" and visual.scale == (0.1, 0.1, 0.2)
    assert np.allclose(visual.T_link_visual.matrix[:3, :3], R, atol=1e-6)
    assert np.allclose(visual.T_link_visual.translation, [0, 0.1, 0], atol=1e-6)


def test_a_keyframe_is_a_named_state(tmp_path):
    model = load_robot(arm(tmp_path))
    state = model.named_state("arm", "up")
    assert dict(zip(state.joint_names, state.positions)) == {"pan": 0.1, "lift": 0.2, "elbow": 0.05}
    assert np.array_equal(model.named_state("arm", "home").positions, state.positions)  # the only keyframe


@pytest.mark.parametrize(
    ("more", "rule"),
    [
        ('<equality><joint joint1="r" joint2="l"/></equality>', (1.0, 0.0)),
        ('<equality><joint joint1="r" joint2="l" polycoef="0.01 0.5 0 0 0"/></equality>', (0.5, 0.01)),
        ('<equality><joint joint1="l" joint2="r" polycoef="0.01 0.5 0 0 0"/></equality>', (2.0, -0.02)),
        (f"{TENDON}{DRIVE}", (1.0, 0.0)),
        (f"{TENDON.replace(BACK[0], BACK[1])}{DRIVE}", (-1.0, 0.04)),
        (f'{TENDON}<equality><tendon tendon1="t"/></equality>', (-1.0, 0.0)),
    ],
)
def test_coupled_fingers_mimic_the_first(tmp_path, more, rule):
    (tmp_path / "jaws.xml").write_text(JAWS.format(more))
    model = load_mjcf(tmp_path / "jaws.xml")
    assert model.joint_names == ("l",)
    mimic = model.joints["r"].mimic
    assert mimic is not None and mimic.joint == "l"
    assert (mimic.multiplier, mimic.offset) == pytest.approx(rule)


def test_an_actuator_decides_which_finger_drives(tmp_path):
    equality = '<equality><joint joint1="r" joint2="l" polycoef="0 -2 0 0 0"/></equality>'
    drive = '<actuator><position joint="r" kp="9"/></actuator>'
    (tmp_path / "jaws.xml").write_text(JAWS.format(equality + drive))
    model = load_mjcf(tmp_path / "jaws.xml")
    mimic = model.joints["l"].mimic
    assert model.joint_names == ("r",)
    assert mimic is not None and mimic.multiplier == pytest.approx(-0.5)


def test_a_tendon_servo_acts_on_the_driven_finger(tmp_path):
    (tmp_path / "jaws.xml").write_text(JAWS.format(TENDON + DRIVE))
    joint = load_mjcf(tmp_path / "jaws.xml").joints["l"]
    assert joint.servo is not None and joint.servo.kp == pytest.approx(400.0)  # length = l + r = 2 l
    assert joint.limits.effort == pytest.approx(40.0)


def test_a_closed_linkage_follows_its_driver(tmp_path):
    (tmp_path / "linkage.xml").write_text(LINKAGE)
    model = load_mjcf(tmp_path / "linkage.xml")
    assert model.joint_names == ("crank",)
    rules = {n: j.mimic for n, j in model.joints.items() if j.mimic}
    assert rules["rocker"].multiplier == pytest.approx(1.0, abs=1e-3)
    assert rules["coupler"].multiplier == pytest.approx(-1.0, abs=1e-3)
    tree = kinematic_tree(model)  # a parallelogram: the coupler keeps its orientation
    assert np.allclose(tree.link_pose([0.7], "coupler").rotation.matrix, np.eye(3), atol=2e-3)


def test_objects_and_a_free_base(tmp_path, caplog):
    text = JAWS.format("").replace(
        '<body name="palm">',
        '<body name="cube"><freejoint/><geom size=".1"/></body><body name="palm"><freejoint/>',
    )
    (tmp_path / "jaws.xml").write_text(text)
    model = load_mjcf(tmp_path / "jaws.xml")
    assert model.root_link == "palm" and "cube" not in model.links
    assert "cube" in caplog.text


def test_joints_without_an_actuator_are_named(tmp_path, caplog):
    with caplog.at_level(logging.WARNING):
        load_mjcf(arm(tmp_path, ARM.replace('<position class="servo" joint="pan"/>', "")))
    assert "joints without an actuator: pan" in caplog.text


def test_moving_links_without_collision_geometry_are_named(tmp_path, caplog):
    """As in Menagerie's `mjx_panda.xml`, whose arm would go through obstacles."""
    mesh = '<geom type="mesh" mesh="tip"'
    assert mesh in ARM
    with caplog.at_level(logging.WARNING):
        load_mjcf(arm(tmp_path))
        assert "collision geometry" not in caplog.text
        load_mjcf(arm(tmp_path, ARM.replace(mesh, mesh + ' contype="0" conaffinity="0"')))
    assert "links without collision geometry: fore" in caplog.text


def test_a_joint_that_only_a_spring_holds_rests(tmp_path):
    """Soft fingertips are no joints of the arm (Hello Robot Stretch); physics keeps their joints."""
    soft = '<joint name="soft" axis="0 1 0" stiffness="3" springref="20"/><joint name="elbow"'
    text = ARM.replace('<joint name="elbow"', soft).replace("0.1 0.2 0.05", "0.1 0.2 0.1 0.05")
    file = arm(tmp_path, text)
    model = load_mjcf(file)
    assert model.joint_names == ("pan", "lift", "elbow") and model.joints["soft"].type == "fixed"
    assert model.mjcf[0].states["up"].keys() == set(model.joint_names)
    mj = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(mj)
    data.qpos[:] = mj.qpos_spring
    mujoco.mj_kinematics(mj, data)
    q = [mj.qpos_spring[mj.joint(name).qposadr[0]] for name in model.joint_names]
    T = kinematic_tree(model).link_pose(q, "fore")
    np.testing.assert_allclose(T.translation, data.body("fore").xpos, atol=1e-12)


def test_includes_from_other_folders(tmp_path):
    (tmp_path / "parts").mkdir()
    jaws = JAWS.format('<include file="parts/more.xml"/>')
    (tmp_path / "jaws.xml").write_text(jaws)
    (tmp_path / "parts" / "more.xml").write_text(
        '<mujocoinclude><equality><joint joint1="r" joint2="l"/></equality></mujocoinclude>'
    )
    assert load_mjcf(tmp_path / "jaws.xml").joint_names == ("l",)


def test_unnamed_bodies_and_joints_get_names(tmp_path):
    bodies = '<body><geom size=".1"/><body><joint/><geom size=".1"/></body></body>'
    text = f"<mujoco><worldbody>{bodies}</worldbody></mujoco>"
    (tmp_path / "plain.xml").write_text(text)
    model = load_mjcf(tmp_path / "plain.xml")
    assert model.joint_names == ("base_child_joint",) and set(model.links) == {"base", "base_child"}


def test_excludes_and_adjacent_bodies_need_no_check(tmp_path):
    model = load_robot(arm(tmp_path, ARM.replace("<actuator>", f"{EXCLUDE}<actuator>")))
    pairs = model.disabled_collisions
    assert pairs[frozenset(("base", "upper"))] == "Adjacent"  # two joints in one body
    assert pairs[frozenset(("base", "fore"))] == "User"


def test_prefixes_and_composition(tmp_path):
    model = load_robot(arm(tmp_path))
    two = compose("two", [MountedRobot(model, "a_"), MountedRobot(model, "b_")])
    assert {part.prefix for part in two.mjcf} == {"a_", "b_"}
    assert "b_tool" in two.links and two.dof == 6


def test_an_mjcf_in_robot_yaml(tmp_path):
    arm(tmp_path)
    (tmp_path / "robot.yaml").write_text("name: mine\nmjcf: arm.xml\n")
    assert load_robot(tmp_path).joint_names == ("pan", "lift", "elbow")


BAD = [
    (ARM.replace("tip.obj", "none.obj"), r"arm.xml:9: <mesh file='none.obj'>: file .*none.obj not found"),
    (
        ARM.replace('<geom class="bar"/>\n        <frame', '<geom typo="1"/>\n        <frame'),
        r"arm.xml:18: .*typo",
    ),
    (ARM.replace('joint="elbow"', 'joint="knee"'), r"arm.xml:.*knee"),
    (ARM.replace('type="slide"', 'type="ball"'), "'elbow' is a ball joint.*three hinges"),
    (
        '<mujoco><include file="gone.xml"/></mujoco>',
        r"arm.xml:1: <include>: included file .*gone.xml not found",
    ),
    ('<mujoco><include file="arm.xml"/></mujoco>', "nested deeper than 30"),
    ("<mujoco><worldbody/></mujoco>", "has no <body>"),
    ('<mujoco><worldbody><body><geom size="1"/></body></worldbody></mujoco>', "no joint that moves"),
    ("<mujoco", "is not valid XML"),
]


@pytest.mark.parametrize(("text", "reason"), BAD)
def test_faults_are_named(tmp_path, text, reason):
    with pytest.raises(InputError, match=reason):
        load_mjcf(arm(tmp_path, text))


def test_a_file_that_is_neither_urdf_nor_mjcf(tmp_path):
    (tmp_path / "sdf.xml").write_text("<sdf/>")
    with pytest.raises(InputError, match="<robot>"):
        load_robot(tmp_path / "sdf.xml")
