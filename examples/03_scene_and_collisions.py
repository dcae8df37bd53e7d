"""Build a planning scene, ask what touches and how far things are, and plan around them.

A scene is an immutable value: every `with_...` gives a changed copy, so a planner can look at
"what if" without disturbing anything.

    python examples/03_scene_and_collisions.py
"""

import armcell
from armcell.collision import ExactChecker
from armcell.core import SE3, Box, JointGoal, JointState, PlanRequest
from armcell.planning import plan
from armcell.scene import CollisionObject, PlanningScene

robot = armcell.load_robot("panda")
arm = robot.group("arm").joint_names
table = CollisionObject.single("table", Box(1.2, 1.6, 0.04), SE3.from_xyz(0.4, 0.0, -0.03))
wall = CollisionObject.single("wall", Box(0.5, 0.02, 0.5), SE3.from_xyz(0.5, 0.0, 0.25))
scene = PlanningScene.of(robot, objects=[table, wall]).with_padding(0.005)  # 5 mm around every link

# One side of the wall, and the other.
left = JointState(arm, [0.6, 0.2, 0.0, -2.0, 0.0, 2.2, 0.8])
right = JointState(arm, [-0.6, 0.2, 0.0, -2.0, 0.0, 2.2, 0.8])
ahead = JointState(arm, [0.0, 0.2, 0.0, -2.0, 0.0, 2.2, 0.8])

checker = ExactChecker(scene)
for name, state in (("left", left), ("ahead", ahead), ("right", right)):
    q = scene.with_state(state).positions
    contacts = checker.contacts(q, padded=False)
    print(f"{name:6s}", contacts[0].describe() if contacts else "free;", end=" ")
    nearest = checker.nearest(q)
    print("" if contacts else f"nearest: {nearest.describe()}")

# A straight motion in joint space would go through the wall, so the planner goes around it.
scene = scene.with_state(left)
result = plan(scene, PlanRequest("arm", (JointGoal(right),), seed=3))
print(f"\naround the wall: {result.code.name} by {result.planner_id}")
print(f"{result.trajectory.duration:.2f} s, {result.min_clearance * 1000:.0f} mm clear of everything")

# The whole motion is proven free between its samples as well; here is a look of our own on top.
looks = [JointState(arm, q) for q in result.trajectory.positions]
touching = [q for q in looks if checker.contacts(scene.with_state(q).positions, padded=False)]
print(f"we look at {len(looks)} points of it: {len(touching)} touch anything")

# Without the wall the straight line will do. `scene` itself is unchanged.
free = plan(scene.without_object("wall"), PlanRequest("arm", (JointGoal(right),)))
print(f"without it: {free.planner_id}, {free.trajectory.duration:.2f} s; the scene still has", *scene.objects)

# Attach a bar to the hand: it moves with it, and is now part of what must not collide.
hand = scene.frame_pose("panda_hand_tcp")
bar = CollisionObject.single("bar", Box(0.02, 0.4, 0.02), hand, movable=True)
holding = scene.with_object(bar).with_attached("bar", "panda_hand_tcp", touch_links=["panda_hand"])
print("\nthe held bar touches:", end=" ")
print("; ".join(c.describe() for c in ExactChecker(holding).contacts(holding.positions)))

# It goes through between the fingers: say that this is meant (MoveIt's allowed collision matrix).
holding = holding.with_allowed("bar", ["panda_leftfinger", "panda_rightfinger"])
print("allowed, it touches:", len(ExactChecker(holding).contacts(holding.positions)), "bodies")
way = holding.with_state(right).frame_pose("bar").distance_to(holding.frame_pose("bar"))[0]
print(f"with the arm on the other side of the wall the bar has moved {way:.2f} m")
