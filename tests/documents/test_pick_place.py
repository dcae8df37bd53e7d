"""The second document (six-axis pick and place): every code block, with only its placeholders filled in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import yaml
from tests.documents.reading import PICK_PLACE, block, python, yaml_text
from tests.documents.running import indented, run

from armcell.cell import load
from armcell.core import ErrorCode, JointGoal, JointState, PlanRequest, UnknownNameError
from armcell.planning import plan
from armcell.planning.request import validate_request

CELL = "six_axis_table"
# What the text leaves open: imports, the groups' names, and the helper functions that it only calls.
HEAD = """
import copy, math
import numpy as np
import rospy
from geometry_msgs.msg import PoseStamped
from moveit_commander import MoveGroupCommander, PlanningSceneInterface, PlanningSceneMonitor
from moveit_msgs.msg import Grasp, MoveItErrorCodes, OrientationConstraint, PathConstraints
from tf.transformations import quaternion_from_euler, quaternion_multiply

rospy.init_node("document")
scene, arm, gripper = PlanningSceneInterface(), MoveGroupCommander("arm"), MoveGroupCommander("gripper")
for group in (arm, gripper):
    group.set_max_velocity_scaling_factor(0.6)

def turned(angle):
    first, *others = arm.get_current_joint_values()
    return [first + angle, *others]
"""
POSES = """
def offset_pose(pose, z):
    moved = copy.deepcopy(pose)
    moved.position.z += z
    return moved

def rotate_pose(stamped, angle):
    turned = copy.deepcopy(stamped)
    o = turned.pose.orientation
    now = (o.x, o.y, o.z, o.w)
    o.x, o.y, o.z, o.w = quaternion_multiply(quaternion_from_euler(0, 0, angle), now)
    return turned

def create_via_pose(start, end):
    via = copy.deepcopy(start)
    via.pose.position.y = (start.pose.position.y + end.pose.position.y) / 2
    via.pose.position.z += 0.15
    return via

at = scene.get_object_poses(["object"])["object"]
target_pose = copy.deepcopy(at)
o = target_pose.orientation
o.x, o.y, o.z, o.w = quaternion_from_euler(math.pi, 0, 0)
"""
STAMPED = """
def stamped(pose):
    found = PoseStamped()
    found.header.frame_id, found.pose = "base_link", pose
    return found

target_pose, place_pose = stamped(target_pose), stamped(copy.deepcopy(at))
place_pose.pose.position.y -= 0.25
"""


def part(begin: str, end: str) -> str:
    return python(block(PICK_PLACE, begin, end))


SCENE = ("from moveit_commander import", "避障规划")
MONITOR = ("planning_scene_monitor = ", "- 轨迹")
CONSTRAINTS = ("arm.set_path_constraints(", "- 速度")
SLOW = ("arm.set_max_velocity_scaling_factor(0.3)", "3. 抓取")
GRASPS = ("def generate_grasps", "抓取参数")
BEFORE = ("pre_grasp_pose = ", "- 接近")
APPROACH = ("waypoints = []", "- 闭合")
CLOSE = ("gripper.set_joint_value_target(", "4. 放置")
PLACES = ("def generate_place", "放置稳定")
TASK = ("grasp_result = ", "性能优化")
GET_SCENE = ("from moveit_msgs.msg import", "- 验证")
CHECK_IK = ("ik_solution = ", "- 分析")
LAST_PLAN = ("contact_points", "5.2")
SPEED = ("arm.set_max_acceleration_scaling", "在真实")


@pytest.mark.slow
def test_the_table_and_the_obstacle_are_in_the_scene_and_planned_around(tmp_path):
    after = """
objects = scene.get_objects(["table", "obstacle"])
sizes = {n: [round(d, 3) for d in o.primitives[0].dimensions] for n, o in objects.items()}
assert sizes == {"table": [0.5, 0.8, 0.02], "obstacle": [0.1, 0.1, 0.3]}, sizes
assert abs(objects["table"].pose.position.z - 0.2) < 1e-9
inside = scene.get_object_poses(["obstacle"])["obstacle"]
arm.set_pose_target(inside)
assert not arm.go()
"""
    ran = run(tmp_path, HEAD + part(*SCENE) + after, CELL, "fake")
    assert ran.status == 0, ran.said
    assert "obstacle" in ran.said  # the refusal names the object in the target's place


def test_the_scene_without_imports_says_which_import_is_open(tmp_path):
    ran = run(tmp_path, "import rospy\n" + part(*SCENE), CELL, "fake")
    assert ran.status == 1 and "from geometry_msgs.msg import PoseStamped" in ran.said


def test_the_table_of_planning_parameters(tmp_path):
    """Each row names a setter of the arm and a value."""
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in block(PICK_PLACE, "| arm.set_goal_tolerance", "2.2").splitlines()
        if line.startswith("|")
    ]
    assert len(rows) == 3
    calls = "".join(f"{setter}({value})\n" for setter, value, _ in rows)
    after = """
request = arm.construct_motion_plan_request()
assert arm.get_goal_tolerance() == (0.005, 0.005, 0.005)
assert request.allowed_planning_time == 5.0 and request.num_planning_attempts == 10
assert arm.go(turned(0.3))
"""
    ran = run(tmp_path, HEAD + calls + after, CELL, "fake")
    assert ran.status == 0, ran.said


@pytest.mark.slow
def test_the_monitor_makes_an_octomap_that_is_planned_around(tmp_path):
    """The camera of this cell sees what the scene does not have: the object that the planner is not given."""
    after = """
import time
from moveit_msgs.srv import GetPlanningScene
ask = rospy.ServiceProxy("/get_planning_scene", GetPlanningScene)
from moveit_msgs.msg import PlanningSceneComponents
only = PlanningSceneComponents(components=PlanningSceneComponents.OCTOMAP)
give_up = time.monotonic() + 120
while time.monotonic() < give_up:  # on a busy machine some pictures come too late to be used
    octomap = ask(only).scene.world.octomap.octomap
    if len(octomap.data) > 10:
        break
    rospy.sleep(0.1)
assert octomap.id == "OcTree" and len(octomap.data) > 10, len(octomap.data)
planning_scene_monitor.stopWorldGeometryMonitor()
assert arm.go(turned(0.3))
"""
    # A picture may be 0.5 s of the cell's time old: 2 s here, for it is drawn with low priority.
    ran = run(tmp_path, HEAD + part(*MONITOR) + after, "six_axis_camera", speed=0.25)
    assert ran.status == 0, ran.said
    assert "sensors_3d.yaml" in ran.said  # where ROS configures it


def test_the_path_constraint_as_printed_says_which_fields_are_open(tmp_path):
    after = "assert not arm.go(turned(0.3))\n"
    ran = run(tmp_path, HEAD + part(*CONSTRAINTS) + after, CELL, "fake")
    assert ran.status == 0, ran.said
    for field in ("link_name", "orientation (all zeros)", "absolute_x/y/z_axis_tolerance"):
        assert field in ran.said
    assert "import Constraints instead" in ran.said


@pytest.mark.slow
def test_the_path_constraint_with_its_fields_keeps_the_tool_upright(tmp_path):
    filled = """
def filled(message):
    message.link_name, message.header.frame_id = arm.get_end_effector_link(), "base_link"
    message.orientation = arm.get_current_pose().pose.orientation
    message.absolute_x_axis_tolerance = message.absolute_y_axis_tolerance = 0.1
    message.absolute_z_axis_tolerance = math.pi
    return message
"""
    printed = part(*CONSTRAINTS).replace("OrientationConstraint()", "filled(OrientationConstraint())")
    after = """
before = arm.get_current_pose().pose
target = copy.deepcopy(before)
target.position.z += 0.1
target.position.y += 0.1
arm.set_pose_target(target)
assert arm.go()
trajectory = arm.get_last_planning_result().trajectory.joint_trajectory
assert len(trajectory.points) > 10
"""
    ran = run(tmp_path, HEAD + filled + printed + after, CELL, "fake")
    assert ran.status == 0, ran.said


@pytest.mark.slow
def test_the_speeds_of_both_blocks_are_kept(tmp_path):
    after = """
request = arm.construct_motion_plan_request()
assert request.max_velocity_scaling_factor == {velocity}, request
assert {more}
assert arm.go(turned(0.3))
"""
    slow = run(tmp_path, HEAD + part(*SLOW) + after.format(velocity=0.3, more="True"), CELL, "fake")
    more = "request.max_acceleration_scaling_factor == 0.8 and arm.get_goal_joint_tolerance() == 0.01"
    fast = run(tmp_path, HEAD + part(*SPEED) + after.format(velocity=0.6, more=more), CELL, "fake")
    assert slow.status == 0 == fast.status, slow.said + fast.said


@pytest.mark.long
def test_the_sequence_of_single_steps_lifts_the_object(tmp_path):
    """Pre-grasp, straight approach with three arguments, fingers closed by their group; then a lift."""
    steps = part(*BEFORE) + part(*APPROACH) + part(*CLOSE)
    lift = """
assert fraction == 1.0, fraction
assert list(scene.get_attached_objects()) == ["object"]
up, fraction = arm.compute_cartesian_path([pre_grasp_pose], 0.01)
assert fraction == 1.0 and arm.execute(up), fraction
"""
    before = load(CELL).scene(None).objects["object"].T_world_object.translation[2]
    ran = run(tmp_path, HEAD + POSES + steps + lift, CELL)
    assert ran.status == 0, ran.said
    assert ran.object_at("object")[2] > before + 0.08
    assert ran.live.driver.gripper("gripper").held == "object" and not ran.live.driver.unwanted_contacts()
    assert "taken as jump_threshold" in ran.said and "never closes it" not in ran.said


@pytest.mark.slow
def test_generated_grasps_and_places_do_the_whole_task(tmp_path):
    task = "def task():\n" + indented(part(*TASK)) + "    assert place_result == MoveItErrorCodes.SUCCESS\n"
    source = (
        HEAD
        + POSES
        + STAMPED
        + part(*GRASPS)
        + part(*PLACES)
        + """
grasps = generate_grasps(target_pose)
place_locations = generate_place_locations(place_pose)
assert len(grasps) == 5 and len(place_locations) == 9
"""
    )
    ran = run(tmp_path, source + task + "task()\n", CELL)
    assert ran.status == 0 and "Pick failed" not in ran.said and "Place failed" not in ran.said, ran.said
    before = load(CELL).scene(None).objects["object"].T_world_object.translation
    after = np.array(ran.object_at("object"))
    assert np.all(np.abs(after[:2] - (before[:2] - (0, 0.25))) < 0.025) and abs(after[2] - before[2]) < 2e-3
    assert ran.live.driver.gripper("gripper").held is None and not ran.live.driver.unwanted_contacts()


def test_a_pick_that_fails_ends_the_task_with_its_message(tmp_path):
    task = "def task():\n" + indented(part(*TASK)) + "    rospy.loginfo('went on')\n"
    source = HEAD + POSES + STAMPED + "grasps, place_locations = [Grasp()], [place_pose]\n"
    source += "grasps[0].grasp_pose = stamped(offset_pose(at, z=3.0))\n"
    ran = run(tmp_path, source + task + "task()\n", CELL, "fake")
    assert ran.status == 0 and "Pick failed!" in ran.said and "went on" not in ran.said, ran.said


@pytest.mark.slow
@pytest.mark.parametrize("call", ["arm.stop()", "rospy.sleep(0.5)", "arm.remember_joint_values('here')"])
def test_calls_of_the_tips_end_at_once(tmp_path, call):
    motion = "arm.go(turned(0.3), wait=False)\n"
    ran = run(tmp_path, HEAD + motion + call + "\n", CELL, "fake")
    assert ran.status == 0, ran.said


def test_the_scene_service_that_is_imported_from_msg(tmp_path):
    after = "assert {o.id for o in current_scene.world.collision_objects} >= {'table', 'obstacle'}\n"
    ran = run(tmp_path, HEAD + part(*GET_SCENE) + after, CELL, "fake")
    assert ran.status == 0, ran.said
    assert "from moveit_msgs.srv import GetPlanningScene" in ran.said


@pytest.mark.slow
def test_a_reachable_joint_solution_is_not_called_invalid(tmp_path):
    ran = run(tmp_path, HEAD + part(*CHECK_IK), CELL, "fake")
    assert ran.status == 0 and "IK solution invalid" not in ran.said
    out = part(*CHECK_IK).replace("arm.get_current_joint_values()", "[9.0] * 6")
    refused = run(tmp_path, HEAD + out, CELL, "fake")
    assert refused.status == 1  # as in MoveIt, a target out of limits raises


@pytest.mark.slow
def test_the_last_planning_result_is_the_last_plan(tmp_path):
    ran = run(tmp_path, HEAD + part(*LAST_PLAN), CELL, "fake")
    assert ran.status == 1
    goal = "wanted = turned(0.3)\nassert arm.go(wanted)\n"
    after = "assert np.allclose(contact_points, wanted, atol=1e-3), contact_points\n"
    ran = run(tmp_path, HEAD + goal + part(*LAST_PLAN) + after, CELL, "fake")
    assert ran.status == 0, ran.said
    assert "MoveIt has no get_last_planning_result" in ran.said


def test_the_planner_file_plans_with_its_range_and_timeout():
    text = yaml_text(block(PICK_PLACE, "RRTConnect: range", "轨迹执行"))
    configs = yaml.safe_load(text)
    assert configs == {"RRTConnect": {"range": 0.1, "timeout": 2.0}}
    scene = load(CELL).scene(None)
    here = scene.state.reindexed(scene.model.group("arm").joint_names)
    first, *others = here.positions
    goal = JointGoal(JointState(here.joint_names, np.array([first + 0.4, *others])))
    request = PlanRequest("arm", (goal,), planner_id="RRTConnect", planner_configs=configs)
    result = plan(scene, request)
    assert result.code is ErrorCode.SUCCESS, result.message
    validated = validate_request(scene, request)
    assert validated.choice.settings.range == 0.1 and validated.request.planning_time == 2.0
    with pytest.raises(UnknownNameError, match="rangee"):
        plan(scene, replace(request, planner_configs={"RRTConnect": {"rangee": 0.1}}))
