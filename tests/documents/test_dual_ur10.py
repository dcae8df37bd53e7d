"""The third document (dual UR10): its Python, xacro and YAML blocks, tables, and launch arguments."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from tests.documents.reading import DUAL, block, document, python, xml_text, yaml_text
from tests.documents.running import SPEEDS, run

import armcell
from armcell.cell import load
from armcell.core import StateSample
from armcell.model import load_robot
from armcell.ros import Bus
from armcell.ros.nodes import ServedCell
from armcell.sim.gain_files import with_gains
from armcell.sim.settings import effective_gains
from armcell.sim.step_response import step_responses

CELL = "dual_ur10"
MOVE_BOTH = ("import rospy from moveit_commander", "注意execute方法")
XACRO = ("xacro:macro namedual_ur10 ", "这里面最关键")
CONTROLLERS = ("arm_left_joint_trajectory_controller: type", "右臂类似")
SWITCH = ("arg namesim ", "在MoveIt配置里")


class Watch:
    """Keep what the driver measures."""

    def __init__(self):
        self.samples: list[StateSample] = []

    def on_state(self, sample):
        self.samples.append(sample)

    def on_event(self, event):
        pass

    def on_trajectory(self, time, trajectory):
        pass


@pytest.mark.slow
def test_both_arms_move_at_once_to_their_poses(tmp_path):
    poses = """
for group in (left_group, right_group):
    group.set_max_velocity_scaling_factor(0.5)
left_pose, right_pose = left_group.get_current_pose().pose, right_group.get_current_pose().pose
left_pose.position.z += 0.1
right_pose.position.z += 0.1
move_both(left_pose, right_pose)
"""
    from armcell.moveit import run_script

    file, watch = tmp_path / "task.py", Watch()
    file.write_text(python(block(DUAL, *MOVE_BOTH), lost=True) + poses)
    live = load(CELL).connect("sim", None, [watch], time_scale=SPEEDS["sim"])
    status, session = run_script(file, live, quiet=True)
    assert status == 0 and "plan failed" not in "\n".join(session.lines), session.lines
    names = live.model.joint_names
    moving = np.array([np.abs(s.joints.velocities) > 0.02 for s in watch.samples])
    left = moving[:, [n.startswith("left_") and "finger" not in n for n in names]].any(axis=1)
    right = moving[:, [n.startswith("right_") and "finger" not in n for n in names]].any(axis=1)
    assert left.sum() > 20 and (left & right).sum() > 0.5 * max(left.sum(), right.sum())
    first, last = watch.samples[0].joints, live.driver.joint_state()
    scenes = [live.scene_at_start.with_state(s) for s in (first, last)]
    for tip in (live.model.group(g).tip_link for g in ("left_arm", "right_arm")):
        before, after = (scene.frame_pose(tip).translation for scene in scenes)
        assert np.allclose(after - before, (0, 0, 0.1), atol=2e-3)
    assert not live.driver.unwanted_contacts()


def test_a_plan_that_fails_is_not_executed(tmp_path):
    out_of_reach = """
pose = left_group.get_current_pose().pose
pose.position.x += 5.0
before = left_group.get_current_joint_values()
move_both(pose, right_group.get_current_pose().pose)
assert max(abs(a - b) for a, b in zip(before, left_group.get_current_joint_values())) < 1e-3
"""
    ran = run(tmp_path, python(block(DUAL, *MOVE_BOTH), lost=True) + out_of_reach, CELL, "fake")
    assert ran.status == 0 and "always true" in ran.said and "nothing is executed" in ran.said, ran.said


def ur10_package(folder):
    """A `ur_description` with the macro that the text includes, made of armcell's own UR10."""
    (folder / "ur_description" / "urdf").mkdir(parents=True)
    (folder / "ur_description" / "package.xml").write_text("<package><name>ur_description</name></package>")
    model = armcell.load_robot("ur10")
    parts = [f'<link name="${{prefix}}{name}"/>' for name in model.links]
    for joint in model.joints.values():
        kind = "revolute" if joint.movable else "fixed"
        limit = '<limit lower="-6.28" upper="6.28" velocity="2" effort="100"/><axis xyz="0 0 1"/>'
        more = limit if joint.movable else ""
        ends = f'<parent link="${{prefix}}{joint.parent}"/><child link="${{prefix}}{joint.child}"/>'
        parts.append(f'<joint name="${{prefix}}{joint.name}" type="{kind}">{ends}{more}</joint>')
    body = "".join(parts)
    macro = f'<xacro:macro name="ur10_macro" params="prefix joint_limited">{body}</xacro:macro>'
    (folder / "ur_description" / "urdf" / "ur10_macro.xacro").write_text(
        f'<robot xmlns:xacro="http://www.ros.org/wiki/xacro">{macro}</robot>'
    )
    return model


def test_the_macro_gives_two_arms_with_prefixes(tmp_path, monkeypatch):
    single = ur10_package(tmp_path)
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path))
    tags = ("xacro:macro", "xacro:include", "xacro:ur10_macro")
    root = ElementTree.fromstring(xml_text(block(DUAL, *XACRO), tags, "robot"))
    text = (
        ElementTree.tostring(root, encoding="unicode")
        .replace("ns0:", "xacro:")
        .replace("xmlns:ns0", "xmlns:xacro")
    )
    base = single.root_link
    mounts = "".join(
        f'<joint name="{side}_mount" type="fixed"><parent link="world_link"/>'
        f'<child link="{side}_{base}"/></joint>'
        for side in ("left", "right")
    )
    text = text.replace("</robot>", f'<link name="world_link"/><xacro:dual_ur10/>{mounts}</robot>')
    text = text.replace("<robot", '<robot name="dual"', 1)
    file = tmp_path / "dual.urdf.xacro"
    file.write_text(text)
    model = load_robot(file)
    wanted = {f"{side}_{name}" for side in ("left", "right") for name in single.links}
    assert set(model.links) == {*wanted, "world_link"} and model.root_link == "world_link"
    assert len(model.joint_names) == 2 * len(single.joint_names)


def test_the_gains_of_the_controllers_move_the_left_arm(tmp_path):
    """The joints have the cell's names; each gets its own gains in physics."""
    text = yaml_text(block(DUAL, *CONTROLLERS))
    (controller,) = yaml.safe_load(text).values()
    cell = load(CELL)
    names = cell.model.group("left_arm").joint_names
    assert list(names) == controller["joints"] == list(controller["gains"])
    file = tmp_path / "controllers.yaml"
    file.write_text(text)
    settings = with_gains(cell.physics, str(file), cell.model)
    for name, gains in controller["gains"].items():
        drive = effective_gains(cell.model.joint(name), settings)
        assert (drive.kp, drive.ki, drive.kv) == (gains["p"], gains["i"], gains["d"]), name
    assert effective_gains(cell.model.joint("right_elbow_joint"), settings).kp != 60.0
    response = step_responses(cell.scene(), (names[0],), settings, 0.05, 0.5)[0]
    assert np.all(np.isfinite(response.positions))


def test_the_interfaces_of_the_table_exist_for_each_arm():
    """The table calls an arm `/arm_left/...`; armcell calls it by its group, and remaps as ROS does."""
    rows = re.findall(r"/arm_(left|right)/(\w+?)(?=sensor_msgs|moveit_msgs|control_msgs)", document(DUAL))
    assert len(rows) == 6
    bus = Bus()
    with ServedCell(load(CELL).connect("fake", time_scale=20.0), bus):
        names = {t.name for t in bus.topics()}
        types = {t.name: t.type for t in bus.topics()}
        for side, what in rows:
            found = {
                "joint_states": f"/{side}_arm/joint_states",
                "move_group": "/move_group/goal",  # one node plans for both: each avoids the other
                "follow_joint_trajectory": f"/{side}_arm_controller/follow_joint_trajectory/goal",
            }[what]
            assert found in names
        assert types["/planning_scene"] == "moveit_msgs/PlanningScene"


def test_the_switch_between_simulation_and_robots_is_one_argument():
    """`sim:=true` and `false` are armcell's `--mode sim` and `real`, with the addresses in the cell file."""
    root = ElementTree.fromstring(xml_text(block(DUAL, *SWITCH), ("arg", "group", "node"), "launch"))
    arguments = {a.get("name"): a.get("default") for a in root.findall("arg")}
    assert arguments == {"sim": "true", "robot_ip_left": "192.168.1.50"}
    real = load(CELL).spec.real
    assert real is not None and set(real["arms"] if isinstance(real, dict) else real.arms) == {
        "left_arm",
        "right_arm",
    }
