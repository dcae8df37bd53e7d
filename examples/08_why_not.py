"""Why not, and what would help? Every plan that fails explains itself, with changes that can be applied.

An explanation names what touches and how deep, looks at every joint solution of a pose, takes obstacles
away one by one, and looks for the nearest goal that works. What it suggests it has tried.

    python examples/08_why_not.py
"""

import armcell
from armcell.core import SE3, Box, CartesianRequest, JointGoal, JointState, PlanRequest, PoseGoal
from armcell.planning import explain, plan, plan_cartesian
from armcell.scene import CollisionObject, PlanningScene

robot = armcell.load_robot("panda")
table = CollisionObject.single("table", Box(1.2, 1.6, 0.04), SE3.from_xyz(0.4, 0.0, -0.03))
wall = CollisionObject.single("wall", Box(0.5, 0.02, 0.5), SE3.from_xyz(0.5, 0.0, 0.25))
aside = JointState(robot.group("arm").joint_names, [0.6, 0.2, 0.0, -2.0, 0.0, 2.2, 0.8])
scene = PlanningScene.of(robot, objects=[table, wall]).with_padding(0.005).with_state(aside)


def down(x, y, z):
    """A pose of the hand that points down."""
    return SE3.from_xyz_rpy((x, y, z), (3.141592653589793, 0.0, 0.0))


# A pose inside the wall: plan() says no, explain() says why.
request = PlanRequest("arm", (PoseGoal(down(0.5, 0.03, 0.3)),))
result = plan(scene, request)
explanation = result.explain()
print(explanation.text())

# Each suggestion can be applied: it gives the changed scene and request.
for suggestion in explanation.suggestions:
    changed_scene, changed_request = suggestion.apply(scene, request)
    print(f"-> {suggestion.text}: {plan(changed_scene, changed_request).code.name}")

# The same as data, for programs: pairs, depths, joint solutions, distances.
touching = explanation.contacts[0]
print(f"\n{touching.body_a} and {touching.body_b}: {-touching.distance * 1000:.0f} mm deep")
print(f"the nearest goal that works is {explanation.data['nearest_goal_m'] * 1000:.0f} mm away")

# Out of reach: how far, and the nearest pose there is.
far = plan(scene, PlanRequest("arm", (PoseGoal(down(1.2, 0.3, 0.3)),))).explain()
beyond = far.data["distance_m"] - far.data["reach_m"]
print(f"\n{far.code.name}: {beyond * 1000:.0f} mm beyond reach; {far.suggestions[0].text}")

# A joint goal outside the limits.
bent = plan(scene, PlanRequest("arm", (JointGoal(JointState(("panda_joint4",), [0.3])),))).explain()
print(f"{bent.code.name}: {bent.details[-1]}; {bent.suggestions[0].text}")

# A straight line that stops on its way, and what would complete it.
line = CartesianRequest("arm", (scene.frame_pose("panda_hand_tcp").shifted(y=-0.5),))
stopped = plan_cartesian(scene, line)
print(f"\nthe line comes {stopped.fraction:.0%} of its way: {stopped.message}")
for suggestion in stopped.explain().suggestions[:3]:
    print(f"-> {suggestion.text}")

# Requests that are wrong in themselves raise errors; explain() takes them, too.
typo = explain(scene, PlanRequest("arms", request.goals, velocity_scaling=0.5))
print(f"\n{typo.code.name}: {typo.summary}")
