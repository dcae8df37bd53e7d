"""Load a robot and look at it: joints, limits, groups, named states; where the hand is and how to move it.

A `RobotModel` says what a robot is and never changes. Where it stands is a `JointState`, a value of its own;
a `PlanningScene` puts the two together.

    python examples/01_load_a_robot.py
"""

import numpy as np

import armcell
from armcell.core import SE3, JointState
from armcell.kinematics import ik_solver, kinematic_tree
from armcell.model import robot_names
from armcell.scene import PlanningScene

# Robots come from the library by name, or from your own URDF, xacro or robot folder by path.
print("in the library:", ", ".join(robot_names()))
robot = armcell.load_robot("panda")
print(f"{robot.name}: {len(robot.links)} links, {robot.dof} actuated joints")

# Joint order is the model's, and names travel with every vector of numbers.
print("\njoint                  from      to   velocity")
for name in robot.joint_names:
    limits = robot.joint(name).limits
    print(f"{name:20s} {limits.lower:7.2f} {limits.upper:7.2f} {limits.velocity:8.2f} /s")

# Groups, named states and grippers are the SRDF's, as in MoveIt.
for group in robot.groups.values():
    states = ", ".join(robot.named_states.get(group.name, {})) or "none"
    print(f"group {group.name!r}: {len(group.joint_names)} joints, named states: {states}")
gripper = robot.gripper()
print(f"gripper {gripper.name!r} opens {gripper.max_width * 1000:.0f} mm, up to {gripper.max_force:.0f} N")

# Forward kinematics: a scene is the model at some joint positions.
home = robot.named_state("arm", "home")
scene = PlanningScene.of(robot).with_state(home)
T_world_hand = scene.frame_pose(gripper.tcp_link)
print("\nat home the hand is at", T_world_hand)

# `T_a_b` maps coordinates in frame b to frame a. 10 cm down in the world:
target = T_world_hand.shifted(z=-0.10)

# Inverse kinematics: the solution nearest to where the arm is.
ik = ik_solver(robot, "arm")
answer = ik.solve(target, scene.positions)
print("10 cm lower:", np.round(np.rad2deg(answer.positions), 1), "deg")
lowered = scene.with_state(JointState(ik.joint_names, answer.positions))
reached = lowered.frame_pose(gripper.tcp_link)
print(f"error of the solution: {reached.distance_to(target)[0] * 1000:.4f} mm")

# The Jacobian tells how fast the hand moves when the joints do.
J = kinematic_tree(robot).jacobian(scene.positions, gripper.tcp_link, ik.joint_names)
print("joint 1 at 1 rad/s moves the hand at", np.round(J[:3, 0], 3), "m/s")

# What cannot be done is an answer with a reason, not an exception and not None.
far = ik.solve(SE3.from_xyz(2.0, 0.0, 0.5), scene.positions)
print(f"\n2 m away: {far.code.name}: {far.message}")
