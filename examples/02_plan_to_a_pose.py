"""Plan a motion of the arm to a pose of its hand, and see what the planner answers when there is none.

A request names a group and one or more goals; the result carries the path, the timed trajectory, and
for a failure the MoveIt error code, one line for people and the evidence.

    python examples/02_plan_to_a_pose.py
"""

import numpy as np

import armcell
from armcell.core import SE3, Box, CartesianRequest, JointState, NamedGoal, PlanRequest, PoseGoal
from armcell.planning import explain_pose, plan, plan_cartesian
from armcell.scene import CollisionObject, PlanningScene

robot = armcell.load_robot("panda")
scene = PlanningScene.of(robot)  # at its home state, in an empty world

# The hand 40 cm to the left of home, still pointing down (half a turn about x).
target = SE3.from_xyz_rpy((0.40, 0.40, 0.40), (np.pi, 0.0, 0.0))
result = plan(scene, PlanRequest("arm", (PoseGoal(target),), velocity_scaling=0.5, acceleration_scaling=0.3))
print(f"{result.code.name}: by {result.planner_id} in {result.planning_time * 1000:.0f} ms")
trajectory = result.trajectory
print(f"{len(result.path.waypoints)} waypoints, {trajectory.duration:.2f} s, {len(trajectory.times)} points")

# The trajectory keeps the limits of every joint, times the scaling asked for.
share = np.abs(trajectory.velocities).max(0) / robot.limits(trajectory.joint_names, "velocity")
print(f"fastest joint: {trajectory.joint_names[share.argmax()]} at {share.max():.0%} of its limit")

# It ends where it should: put the last point into the scene and look at the hand.
there = scene.with_state(JointState(trajectory.joint_names, trajectory.positions[-1]))
print(
    f"the hand ends {there.frame_pose('panda_hand_tcp').distance_to(target)[0] * 1000:.3f} mm from the target"
)

# Several goals: any one will do. A named state is a goal, too.
either = plan(scene, PlanRequest("arm", (NamedGoal("extended"), PoseGoal(target)), seed=1))
print(f"extended or left: {either.code.name}, {either.trajectory.duration:.2f} s at full speed")

# A straight line of the hand: 30 cm down. `fraction` says how much of it can be done.
down = there.frame_pose("panda_hand_tcp").shifted(z=-0.30)
line = plan_cartesian(there, CartesianRequest("arm", (down,), velocity_scaling=0.2))
print(f"straight down: {line.fraction:.0%} in {line.trajectory.duration:.2f} s")

# Not possible: a code and a reason.
too_far = SE3.from_xyz_rpy((0.9, 0.4, 0.4), (np.pi, 0.0, 0.0))
no = plan(scene, PlanRequest("arm", (PoseGoal(too_far),)))
print(f"\n{no.code.name}: {no.message}")
print(f"it is {no.evidence['distance_m']:.2f} m from the shoulder")

# `explain_pose` looks at every joint solution of a pose and says what is wrong with each.
box = CollisionObject.single("box", Box(0.1, 0.1, 0.1), target)
blocked = explain_pose(scene.with_object(box), "arm", target)
print(f"with a box at the target: {blocked.summary}")
for branch in blocked.branches[:3]:
    print("  joints", np.rad2deg(branch.positions).round(), "deg:", branch.contacts[0].describe())
