"""MoveIt packages: read as they are, written again without loss, and what is wrong with them named."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
from tests.model.helpers import collision, joint, link, robot

from armcell.core import InputError, UnknownNameError
from armcell.model import MoveItConfig, load_robot

BOX = collision('<box size="0.1 0.1 0.1"/>')
URDF = robot(
    *(link(f"l{i}", BOX) for i in range(4)),
    *(
        joint(f"j{i}", f"l{i - 1}", f"l{i}", inside='<origin xyz="0.3 0 0"/><axis xyz="0 0 1"/>')
        for i in (1, 2, 3)
    ),
)
SRDF = """<?xml version="1.0"?>
<robot name="r">
  <group name="arm"><chain base_link="l0" tip_link="l3"/></group>
  <group name="wrist"><joint name="j3"/></group>
  <group_state name="home" group="arm">
    <joint name="j1" value="0.1"/><joint name="j2" value="0.2"/><joint name="j3" value="0.3"/>
  </group_state>
  <end_effector name="hand" parent_link="l2" group="wrist" parent_group="arm"/>
  <virtual_joint name="fixed_base" type="fixed" parent_frame="world" child_link="l0"/>
  <passive_joint name="j3"/>
  <link_sphere_approximation link="l1"><sphere center="0 0 0" radius="0.1"/></link_sphere_approximation>
  <disable_default_collisions link="l0"/>
  <enable_collisions link1="l0" link2="l2"/>
  <disable_collisions link1="l0" link2="l1" reason="Adjacent"/>
  <disable_collisions link1="l1" link2="l2" reason="Adjacent"/>
  <joint_property joint_name="j1" property_name="angular_distance_weight" value="2"/>
</robot>
"""
LIMITS = """robot_description_planning:
  joint_limits:
    j1: {has_velocity_limits: true, max_velocity: 1.5, has_acceleration_limits: true, max_acceleration: 3,
         has_jerk_limits: true, max_jerk: 50.0}
    j2: {has_velocity_limits: true, max_velocity: 99.0, has_acceleration_limits: false, max_acceleration: 0.0}
"""
OMPL = """planning_plugin: ompl_interface/OMPLPlanner
request_adapters: >-
  default_planner_request_adapters/AddTimeOptimalParameterization
planner_configs:
  RRTConnectkConfigDefault: {type: geometric::RRTConnect, range: 0.0}
  TRRT: {type: geometric::TRRT, min_temperature: 10e-10}
arm:
  default_planner_config: TRRT
  planner_configs: [RRTConnectkConfigDefault, TRRT]
  projection_evaluator: joints(j1,j2)
  longest_valid_segment_fraction: 0.005
of_another_robot: {planner_configs: [TRRT]}
"""
CONTROLLERS = """trajectory_execution: {allowed_start_tolerance: 0.01}
moveit_simple_controller_manager:
  controller_names: [arm_controller]
  arm_controller:
    {type: FollowJointTrajectory, action_ns: follow_joint_trajectory, default: true, joints: [j1, j2, j3]}
"""
FILES = {
    "r.urdf": URDF,
    "r.srdf": SRDF,
    "joint_limits.yaml": LIMITS,
    "kinematics.yaml": "arm: {kinematics_solver: kdl/KDLPlugin, kinematics_solver_timeout: 0.005}\n",
    "ompl_planning.yaml": OMPL,
    "moveit_controllers.yaml": CONTROLLERS,
    "sensors_3d.yaml": "sensors: [kinect]\nkinect: {sensor_plugin: PointCloudOctomapUpdater}\n",
    "pilz_cartesian_limits.yaml": "cartesian_limits: {max_trans_vel: 1, max_trans_acc: 2.25}\n",
}


@pytest.fixture
def package(tmp_path) -> Path:
    folder = tmp_path / "r_moveit_config"
    (folder / "config").mkdir(parents=True)
    for name, text in FILES.items():
        (folder / "config" / name).write_text(text)
    return folder


def test_what_a_package_says(package):
    config = MoveItConfig.load(package)
    model = config.model
    assert model.groups["arm"].joint_names == ("j1", "j2", "j3")
    assert model.named_states["arm"]["home"] == {"j1": 0.1, "j2": 0.2, "j3": 0.3}
    limits = {n: model.joints[n].limits for n in ("j1", "j2")}
    assert (limits["j1"].velocity, limits["j1"].acceleration, limits["j1"].jerk) == (1.5, 3.0, 50.0)
    assert limits["j2"].velocity == 2.0  # the URDF's is tighter
    assert limits["j2"].acceleration == 1.0  # MoveIt's default
    assert config.planner_configs["TRRT"] == {"type": "geometric::TRRT", "min_temperature": 1e-9}
    assert config.cartesian_limits == {"max_trans_vel": 1.0, "max_trans_acc": 2.25}
    arm = config.group_planning["arm"]
    assert arm["planner_configs"] == ["RRTConnectkConfigDefault", "TRRT"]
    assert arm["longest_valid_segment_fraction"] == 0.005 and set(config.group_planning) == {"arm"}
    assert config.controllers["arm_controller"]["joints"] == ["j1", "j2", "j3"]
    assert load_robot(package).groups["arm"] == model.groups["arm"]


def test_a_round_trip_loses_nothing(package, tmp_path):
    first = MoveItConfig.load(package)
    first.write(tmp_path / "again")
    second = MoveItConfig.load(tmp_path / "again")
    assert second.srdf == first.srdf and second.files == first.files and second.names == first.names
    for name, text in FILES.items():
        written = (tmp_path / "again" / "config" / name).read_text()
        if name.endswith(".yaml"):
            assert yaml.safe_load(written) == yaml.safe_load(text)
    assert list(second.model.joints) == list(first.model.joints)
    assert second.model.disabled_collisions == first.model.disabled_collisions
    # Every element and attribute of the SRDF, by another reader.
    from lxml import etree

    def flat(text):
        return [(e.tag, dict(e.attrib)) for e in etree.fromstring(text.encode()).iter()]

    assert flat((tmp_path / "again/config/r.srdf").read_text()) == flat(SRDF)


def test_ros1_and_ros2_ways_to_write_the_same(package):
    config = package / "config"
    (config / "moveit_controllers.yaml").unlink()
    (config / "ros_controllers.yaml").write_text(
        "controller_list:\n- {name: a, type: FollowJointTrajectory, joints: [j1, j2]}\n"
    )
    (config / "ompl_planning.yaml").write_text("/**:\n  ros__parameters:\n    ompl:\n" + "".join(
        f"      {line}\n" for line in OMPL.splitlines()))  # fmt: skip
    read = MoveItConfig.load(package)
    assert read.controllers == {"a": {"type": "FollowJointTrajectory", "joints": ["j1", "j2"]}}
    assert set(read.planner_configs) == {"RRTConnectkConfigDefault", "TRRT"}


def test_xacro_and_setup_assistant(package):
    config = package / "config"
    (config / "r.srdf").rename(config / "r.srdf.xacro")
    (package / "urdf").mkdir()
    (config / "r.urdf").rename(package / "urdf" / "deep.urdf.xacro")
    (package / ".setup_assistant").write_text(
        "moveit_setup_assistant_config:\n"
        "  urdf: {package: r_moveit_config, relative_path: urdf/deep.urdf.xacro}\n"
    )
    read = MoveItConfig.load(package)
    assert read.names["urdf"] == "deep.urdf" and "arm" in read.model.groups


WRONG = {
    "joint_limits.yaml": [
        ("joint_limits: [j1]\n", r"joint_limits\.yaml: joint_limits: is a list, a mapping is needed"),
        ("joint_limits: {j9: {}}\n", r"joint_limits: unknown joint 'j9'; known: j1, j2, j3"),
        ("joint_limits: {j1: {max_velocity: fast}}\n", r"joint_limits/j1/max_velocity: .*a number is needed"),
        ("joint_limits: {j1: {has_velocity_limits: 1}}\n", r"j1/has_velocity_limits: .*true or false"),
        ("joint_limits: {j1: 3}\n", r"joint_limits/j1: is a number, a mapping"),
        ("limits: {}\n", r"no mapping 'joint_limits'"),
        ("- a\n", r"joint_limits\.yaml: top level is list"),
        ("a: [\n", r"is not valid YAML"),
    ],
    "kinematics.yaml": [
        ("arm: kdl\n", r"kinematics\.yaml: arm: is a text, a mapping is needed"),
        ("arm: {kinematics_solver: 3}\n", r"arm/kinematics_solver: is a number, a name"),
        ("arm: {kinematics_solver: k, kinematics_solver_timeout: long}\n", r"kinematics_solver_timeout"),
    ],
    "ompl_planning.yaml": [
        ("planner_configs: [RRT]\n", r"ompl_planning\.yaml: planner_configs: is a list, a mapping"),
        ("planner_configs: {RRT: {range: 1}}\n", r"planner_configs/RRT/type: is empty, a name"),
        (
            "planner_configs: {}\narm: {planner_configs: [RTT]}\n",
            r"arm/planner_configs: unknown planner config 'RTT'",
        ),
        ("planner_configs: {}\narm: {planner_configs: RRT}\n", r"arm/planner_configs: is a text, a list"),
        ("arm: {longest_valid_segment_fraction: [1]}\n", r"longest_valid_segment_fraction: is a list"),
    ],
    "moveit_controllers.yaml": [
        ("controller_names: [a]\na: {type: T, joints: [j1, jj2]}\n", r"a/joints: unknown joint 'jj2'"),
        ("controller_names: [b]\na: {type: T}\n", r"controller_names: unknown controller 'b'; known: a"),
        ("controller_names: a\n", r"controller_names: is a text, a list is needed"),
        ("controller_names: [a]\na: {type: 1}\n", r"a/type: is a number"),
        ("controller_names: [a]\na: {type: T, joints: [{}]}\n", r"a/joints: is a mapping, a name"),
    ],
    "sensors_3d.yaml": [
        ("sensors: [lidar]\n", r"unknown sensor 'lidar'"),
        ("sensors: {a: 1}\n", r"sensors: is a mapping, a list"),
    ],
    "pilz_cartesian_limits.yaml": [
        ("cartesian_limits: {max_trans_vel: x}\n", r"cartesian_limits/max_trans_vel")
    ],
    "r.srdf": [
        (SRDF.replace('tip_link="l3"', 'tip_link="l9"'), r"r\.srdf:3: .*unknown link 'l9'"),
        (SRDF.replace('<joint name="j3"/>', '<joint name="j4"/>', 1), r"r\.srdf:4: .*unknown joint 'j4'"),
        ("<sdf/>", r"root element is not <robot>"),
    ],
}


@pytest.mark.parametrize(
    ("name", "text", "message"), [(n, t, m) for n, cases in WRONG.items() for t, m in cases]
)
def test_what_is_wrong_is_named(package, name, text, message):
    (package / "config" / name).write_text(text)
    with pytest.raises(InputError, match=message) as error:
        MoveItConfig.load(package)
    assert name in str(error.value)


@pytest.mark.parametrize("name", ["r.srdf", "r.urdf", "kinematics.yaml"])
def test_a_missing_file_is_named(package, name):
    (package / "config" / name).unlink()
    with pytest.raises(InputError, match=r"file not found|no \*\.") as error:
        MoveItConfig.load(package)
    assert name in str(error.value) or name.rsplit(".", 1)[1] in str(error.value)


@pytest.mark.parametrize("name", ["ompl_planning.yaml", "moveit_controllers.yaml", "sensors_3d.yaml"])
def test_a_file_that_moveit_can_do_without(package, name):
    (package / "config" / name).unlink()
    config = MoveItConfig.load(package)
    assert "arm" in config.model.groups
    assert (config.planner_configs == {}) == (name == "ompl_planning.yaml")


def test_without_joint_limits_moveit_s_defaults_count(package, caplog, tmp_path):
    (package / "config" / "joint_limits.yaml").unlink()
    config = MoveItConfig.load(package)
    assert config.model.joints["j1"].limits.acceleration == 1.0
    assert "has no joint_limits.yaml" in caplog.text
    config.write(tmp_path / "copy")
    assert MoveItConfig.load(tmp_path / "copy").model.joints["j1"].limits == config.model.joints["j1"].limits


def test_packages_as_vendors_publish_them(package, caplog):
    """ROS-Industrial's controllers without a name, UR's degrees, Doosan's SRDF of another name, and keys and
    options of xacro that the Setup Assistant itself writes."""
    (package / "config/moveit_controllers.yaml").write_text(
        'controller_list: [{name: "", action_ns: joint_trajectory_action, type: T, joints: [j1]}]\n'
    )
    (package / "config/joint_limits.yaml").write_text("joint_limits: {j1: {max_velocity: !degrees 36}}\n")
    (package / ".setup_assistant").write_text(
        "moveit_setup_assistant_config:\n"
        "  urdf: {package: '', relative_path: config/r.urdf, xacro_args: '--inorder '}\n"
        "  srdf: {relative_path: config/other.srdf}\n"
        "  control_xacro: {command: [position]}\n"
        "  control_xacro: {command: [velocity]}\n"
    )
    config = MoveItConfig.load(package)
    assert config.controllers["joint_trajectory_action"]["joints"] == ["j1"]
    assert config.model.joints["j1"].limits.velocity == pytest.approx(np.pi / 5)
    assert "control_xacro' is given twice, the last one counts" in caplog.text
    assert "other.srdf, which does not exist" in caplog.text


def test_no_package(package):
    with pytest.raises(InputError, match="no such folder"):
        MoveItConfig.load(package / "nowhere")
    shutil.rmtree(package / "config")
    with pytest.raises(InputError, match="has no folder config/"):
        MoveItConfig.load(package)


def test_setup_assistant_names_a_file_that_is_not_there(package):
    (package / ".setup_assistant").write_text(
        "moveit_setup_assistant_config: {urdf: {package: '', relative_path: urdf/no.urdf}}\n"
    )
    with pytest.raises(InputError, match=r"urdf/no\.urdf: file not found"):
        MoveItConfig.load(package)


def test_an_unknown_name_lists_what_exists(package):
    (package / "config/moveit_controllers.yaml").write_text(
        "controller_names: [a]\na: {type: T, joints: [j22]}\n"
    )
    with pytest.raises(UnknownNameError) as error:
        MoveItConfig.load(package)
    assert error.value.known == ["j1", "j2", "j3"] and "did you mean 'j2'" in str(error.value)
