"""A moveit_commander script as it would run with ROS, run without it: nothing in it knows of armcell.

    armcell run examples/25_moveit_commander_script.py --cell panda_table

It puts a box into the planning scene, goes above the cube and down to it in a straight line, closes the
gripper by its action, lifts, and puts the cube down elsewhere with place().
"""

import copy
import math

import actionlib
import rospy
from control_msgs.msg import GripperCommandAction, GripperCommandGoal
from geometry_msgs.msg import PoseStamped
from moveit_commander import MoveGroupCommander, PlanningSceneInterface
from tf.transformations import quaternion_from_euler

rospy.init_node("tidy_up")
scene = PlanningSceneInterface()
arm = MoveGroupCommander("panda_arm")
arm.set_max_velocity_scaling_factor(0.5)
arm.set_max_acceleration_scaling_factor(0.5)

# An obstacle between the cube and its place; it is there when the call returns.
box = PoseStamped()
box.header.frame_id = "world"
box.pose.position.x, box.pose.position.y, box.pose.position.z = 0.40, -0.085, 0.10
box.pose.orientation.w = 1.0
scene.add_box("divider", box, size=(0.30, 0.02, 0.20))
rospy.loginfo("planning around: %s", ", ".join(scene.get_known_object_names()))

# Above the cube, then straight down.
cube = scene.get_object_poses(["cube"])["cube"]
above = PoseStamped()
above.header.frame_id = "world"
above.pose.position = copy.deepcopy(cube.position)  # a copy: what is added below is not added to the cube's
above.pose.position.z += 0.10
q = quaternion_from_euler(math.pi, 0, 0)
above.pose.orientation.x, above.pose.orientation.y = q[0], q[1]
above.pose.orientation.z, above.pose.orientation.w = q[2], q[3]
arm.set_pose_target(above)
rospy.loginfo("above the cube: %s", arm.go())
at_cube = copy.deepcopy(above.pose)
at_cube.position.z -= 0.10
trajectory, fraction = arm.compute_cartesian_path([at_cube], 0.01, True)
rospy.loginfo("straight down: %.0f %%, %s", fraction * 100, arm.execute(trajectory))

# The gripper closes until it holds; the scene has the cube in the hand from then on.
gripper = actionlib.SimpleActionClient("/hand_controller/gripper_cmd", GripperCommandAction)
gripper.wait_for_server()
goal = GripperCommandGoal()
goal.command.position, goal.command.max_effort = 0.0, 20.0
gripper.send_goal_and_wait(goal)
held = scene.get_attached_objects()
rospy.loginfo("holding: %s, stalled: %s", ", ".join(held), gripper.get_result().stalled)
arm.set_pose_target(above)
rospy.loginfo("lifted: %s", arm.go())

# place() wants to know where the object is to be.
target = PoseStamped()
target.header.frame_id = "world"
target.pose = copy.deepcopy(cube)
target.pose.position.y = -0.24
rospy.loginfo("placed: code %d", arm.place("cube", target))
after = scene.get_object_poses(["cube"])["cube"].position
rospy.loginfo("the cube is at (%.3f, %.3f, %.3f)", after.x, after.y, after.z)
