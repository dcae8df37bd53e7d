"""A gripper group's goal closes onto the object between the fingers, by every way of sending it."""

from __future__ import annotations

import textwrap

import pytest

from armcell.cell import load
from armcell.moveit import run_script

pytestmark = pytest.mark.slow

REACH = """
import copy, math, rospy, actionlib
from control_msgs.msg import FollowJointTrajectoryAction, FollowJointTrajectoryGoal
from control_msgs.msg import GripperCommandAction, GripperCommandGoal
from moveit_commander import MoveGroupCommander, PlanningSceneInterface
from tf.transformations import quaternion_from_euler
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

rospy.init_node("grip")
scene, arm, gripper = PlanningSceneInterface(), MoveGroupCommander("arm"), MoveGroupCommander("gripper")
for group in (arm, gripper):
    group.set_max_velocity_scaling_factor(0.6)
grasp = scene.get_object_poses(["object"])["object"]
o = grasp.orientation
o.x, o.y, o.z, o.w = quaternion_from_euler(math.pi, 0, 0)
above = copy.deepcopy(grasp)
above.position.z += 0.1
gripper.set_named_target("open")
assert gripper.go()
arm.set_pose_target(above)
assert arm.go()
down, fraction = arm.compute_cartesian_path([grasp], 0.01)
assert fraction == 1.0 and arm.execute(down)
"""
LIFT = """
assert list(scene.get_attached_objects()) == ["object"]
up, fraction = arm.compute_cartesian_path([above], 0.01)
assert fraction == 1.0, fraction
assert arm.execute(up)
"""
CLOSE = {
    "values": "gripper.set_joint_value_target([0.02, 0.02])\nassert gripper.go()",
    "named": 'gripper.set_named_target("closed")\nassert gripper.go()',
    "plan and execute": "ok, plan, _, _ = gripper.plan([0.02])\nassert ok and gripper.execute(plan)",
    "follow_joint_trajectory": """
client = actionlib.SimpleActionClient(
    "/gripper_controller/follow_joint_trajectory", FollowJointTrajectoryAction)
assert client.wait_for_server(rospy.Duration(2.0))
point = JointTrajectoryPoint(positions=[0.02], time_from_start=rospy.Duration(1.0))
goal = FollowJointTrajectoryGoal()
goal.trajectory = JointTrajectory(joint_names=gripper.get_active_joints(), points=[point])
client.send_goal_and_wait(goal)
assert client.get_result().error_code == 0, client.get_result()
""",
    "GripperCommand": """
client = actionlib.SimpleActionClient("/gripper_controller/gripper_cmd", GripperCommandAction)
assert client.wait_for_server(rospy.Duration(2.0))
goal = GripperCommandGoal()
goal.command.position = 0.0
client.send_goal_and_wait(goal)
assert client.get_result().stalled
""",
}


@pytest.mark.cases("follow_joint_trajectory")
@pytest.mark.parametrize("close", CLOSE.values(), ids=CLOSE)
def test_closing_holds_and_attaches_the_object_and_the_lift_is_straight(tmp_path, close):
    file = tmp_path / "grip.py"
    file.write_text(textwrap.dedent(REACH + close + LIFT))
    live = load("six_axis_table").connect("sim", time_scale=3.0)
    before = live.scene_at_start.objects["object"].T_world_object.translation[2]
    status, session = run_script(file, live, quiet=True)
    assert status == 0, session.lines
    assert live.driver.gripper("gripper").held == "object"
    assert live.driver.object_poses()["object"].translation[2] > before + 0.08
    assert not live.driver.unwanted_contacts()


def test_a_goal_away_from_objects_still_minds_what_cannot_be_moved(tmp_path):
    """Only movable objects between the fingers may be touched: a fixed one is an obstacle."""
    file = tmp_path / "grip.py"
    fixed = """
arm.execute(arm.compute_cartesian_path([above], 0.01)[0])
p = arm.get_current_pose()
p.pose.orientation.x = p.pose.orientation.y = p.pose.orientation.z = 0.0
p.pose.orientation.w = 1.0
scene.add_box("post", p, size=(0.03, 0.03, 0.03))
assert not gripper.go([0.0])
"""
    file.write_text(REACH + fixed)
    status, session = run_script(file, load("six_axis_table").connect("fake", time_scale=10.0), quiet=True)
    assert status == 0, session.lines
    assert any("post" in line for line in session.lines)


LOGS = 'import rospy\nfrom moveit_commander import MoveGroupCommander\nrospy.init_node("s")\n'
SAYS = 'rospy.loginfo("Close gripper now!")\n'


@pytest.mark.cases("-True", "closing2-False", "*closed*", "*open*")
@pytest.mark.parametrize(
    ("closing", "hinted"),
    [
        ("", True),
        ("g = MoveGroupCommander('hand')\ng.set_named_target('closed')\ng.go()\n", False),
        (
            "from std_msgs.msg import Float64\n"
            "p = rospy.Publisher('/gripper_' + 'command', Float64, queue_size=1)\n"
            "p.publish(0.0)\nrospy.sleep(0.5)\n",
            False,
        ),
        (
            "from actionlib import SimpleActionClient\n"
            "from control_msgs.msg import GripperCommandAction, GripperCommandGoal\n"
            "c = SimpleActionClient('/hand' + '_controller/gripper' + '_cmd', GripperCommandAction)\n"
            "c.wait_for_server()\nc.send_goal_and_wait(GripperCommandGoal())\n",
            False,
        ),
        (
            "from actionlib import SimpleActionClient\n"
            "from control_msgs.msg import FollowJointTrajectoryAction, FollowJointTrajectoryGoal\n"
            "from trajectory_msgs.msg import JointTrajectoryPoint\n"
            "c = SimpleActionClient('/hand' + '_controller/follow_joint_trajectory', "
            "FollowJointTrajectoryAction)\n"
            "g = FollowJointTrajectoryGoal()\ng.trajectory.joint_names = ['panda_finger_joint1']\n"
            "p = JointTrajectoryPoint(positions=[0.0], time_from_start=rospy.Duration(1))\n"
            "g.trajectory.points = [p]\n"
            "c.wait_for_server()\nc.send_goal_and_wait(g)\n",
            False,
        ),
        ("MoveGroupCommander('panda_arm').pick('cube')\n", False),
        ("g = MoveGroupCommander('hand')\ng.set_named_target('open')\ng.go()\n", True),
    ],
)
def test_a_script_that_says_it_closes_the_gripper(tmp_path, closing, hinted):
    file = tmp_path / "says.py"
    file.write_text(LOGS + SAYS + closing)
    status, session = run_script(file, load("panda_table").connect("fake", time_scale=10.0), quiet=True)
    assert status == 0 and ("auto-grip" in session.hints) is hinted
