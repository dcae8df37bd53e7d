"""The first document (Unity and MoveIt): its Python and launch blocks; only placeholders are filled in.

The C# block and the Unity side are covered by tests/unity.
"""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest
from tests.documents.reading import UNITY, block, document, python, xml_text
from tests.documents.running import run

from armcell.cell import load
from armcell.ros import Bus
from armcell.ros.nodes import ServedPlanner

CELL = "panda_table"
SERVER = (
    "import rospy from moveit_commander import MoveGroupCommander, PlanningSceneInterface from geometry",
    "4. 运动规划核心",
)
TABLE = ("def add_table_to_scene(self)", "动态物体同步")
POSE = ("def compute_grasp_pose(self", "更高级的方法")
LAUNCH = ("launch !--", "这个启动文件")
ADDED = ("pre_grasp.pose.position.z", "lift_pose.pose.position.z")  # "10 cm above", "lift": `+=` was lost
MAIN = """
if __name__ == "__main__":
    rospy.init_node("grasp_server")
    server = GraspServer()
    server.move_group.set_max_velocity_scaling_factor(0.5)
    while server.object_pose is None and not rospy.is_shutdown():
        rospy.sleep(0.05)
    server.execute_grasp_sequence()
"""


def server() -> str:
    return python(block(UNITY, *SERVER), lost=True, add=ADDED)


def grasp_pose() -> str:
    """The function of section 4.2, used where the pose of the object comes in."""
    used = """
def object_pose_cb(self, msg):
    self.object_pose = compute_grasp_pose(self, msg.pose)

GraspServer.object_pose_cb = object_pose_cb
"""
    return "from geometry_msgs.msg import Pose\n" + python(block(UNITY, *POSE), lost=True) + used


@pytest.mark.slow
def test_the_grasp_server_with_the_grasp_pose_of_section_4_lifts_the_cube(tmp_path):
    before = load(CELL).scene(None).objects["cube"].T_world_object.translation
    ran = run(tmp_path, server() + grasp_pose() + MAIN, CELL, auto_grip=True)
    assert ran.status == 0 and "Close gripper now!" in ran.said, ran.said
    assert "Planning failed" not in ran.said and "never closes it" not in ran.said
    after = np.array(ran.object_at("cube"))
    assert after[2] - before[2] > 0.15, ran.said
    assert ran.live.driver.gripper("hand").held == "cube"
    assert not ran.live.driver.unwanted_contacts() and not ran.live.driver.welds()


@pytest.mark.slow
def test_the_grasp_server_alone_says_that_the_tool_points_up(tmp_path):
    """The first listing takes the object's own orientation for the tool's; section 4.2 corrects it."""
    ran = run(tmp_path, server() + MAIN, CELL, auto_grip=True)
    assert ran.status == 0 and "Planning failed!" in ran.said
    assert "your tool points up" in ran.said and "quaternion_from_euler(math.pi, 0, yaw)" in ran.said


def test_the_table_is_added_to_the_scene(tmp_path):
    head = """
import rospy
from geometry_msgs.msg import PoseStamped
from moveit_commander import PlanningSceneInterface
rospy.init_node("scene")
class Server:
    planning_scene = PlanningSceneInterface()
"""
    after = """
add_table_to_scene(Server())
table = Server.planning_scene.get_objects(["table"])["table"]
assert list(table.primitives[0].dimensions) == [1.0, 1.0, 0.1]
assert abs(table.pose.position.z + 0.05) < 1e-9 and table.pose.orientation.w == 1.0
"""
    source = python(block(UNITY, *TABLE), lost=True, known=("PoseStamped",))
    ran = run(tmp_path, head + source + after, CELL, "fake")
    assert ran.status == 0, ran.said


@pytest.mark.slow
def test_the_services_and_topics_of_section_2_are_served():
    text = document(UNITY)
    services = ("/compute_ik", "/plan_kinematic_path")
    topics = ("/joint_states", "/object_pose", "/planned_trajectory")
    assert all(name in text for name in (*services, *topics))
    bus = Bus()
    with ServedPlanner(load(CELL), bus):  # as `armcell serve CELL --unity --plan-only`
        names = {t.name for t in bus.topics()}
        assert set(topics) <= names
        assert all(bus.wait_for_service(name, 1.0) for name in services)


def launch() -> ElementTree.Element:
    return ElementTree.fromstring(
        xml_text(block(UNITY, *LAUNCH), ("launch", "node", "param", "include", "arg"))
    )


def test_the_launch_file_names_what_armcell_takes_the_place_of():
    root = launch()
    endpoint, server_node = root.findall("node")
    params = {p.get("name"): p.get("value") for p in endpoint.findall("param")}
    assert params == {"tcp_port": "10000", "topic_list": "[/joint_states, /object_pose]"}
    (fake,) = [a for a in root.iter("arg") if a.get("value") == "fake"]
    assert (
        fake.get("name") == "moveit_controller_manager"
        and server_node.get("type") == "grasp_action_server.py"
    )


@pytest.mark.slow
def test_the_planners_of_section_6_plan_by_name(tmp_path):
    names = block(UNITY, "RRTConnect, PRM", "。").split("等")[0].rstrip(")").replace(",", " ").split()
    assert names[:2] == ["RRTConnect", "PRM"] and "EST" in names[2]
    source = f"""
import rospy
from moveit_commander import MoveGroupCommander
rospy.init_node("planners")
arm = MoveGroupCommander("panda_arm")
arm.set_planning_time(10.0)
first, *others = arm.get_current_joint_values()
for i, name in enumerate({[*names[:2], "EST"]!r}):
    arm.set_planner_id(name)
    assert arm.go([first + 0.3 * (i + 1), *others]), name
"""
    ran = run(tmp_path, source, CELL, "fake")
    assert ran.status == 0, ran.said
