"""Carry a glass without spilling, and keep the tip on a line: path constraints.

They hold along the whole motion, between its points too; that is proven before the motion is returned.

    python examples/09_keep_upright.py
"""

import numpy as np

import armcell
from armcell.core import (
    SE3,
    SO3,
    Box,
    Constraints,
    Cylinder,
    JointState,
    OrientationConstraint,
    PlanRequest,
    PoseGoal,
    PositionConstraint,
)
from armcell.planning import plan
from armcell.scene import CollisionObject, PlanningScene

robot = armcell.load_robot("panda")
post = CollisionObject.single("post", Box(0.06, 0.06, 0.9), SE3.from_xyz(0.5, 0.0, 0.45))
scene = PlanningScene.of(robot, objects=[post])

# The hand points ahead: its z axis along the world's x, its x axis down.
ahead = SO3(np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]))
right, left = (SE3(ahead, np.array([0.5, y, 0.4])) for y in (-0.3, 0.3))


def arrived(scene, result):
    return scene.with_state(JointState(result.trajectory.joint_names, result.trajectory.positions[-1]))


def states(scene, result):
    """The scene every 10 ms of a motion."""
    trajectory = result.trajectory
    for t in np.arange(0.0, trajectory.duration + 0.01, 0.01):
        yield scene.with_state(JointState(trajectory.joint_names, trajectory.sample(t)[0]))


# Take the glass: it stands upright between the fingers.
scene = arrived(scene, plan(scene, PlanRequest("arm", (PoseGoal(right),))))
stands = SE3.from_xyz(0.5, -0.3, 0.4)
scene = scene.with_object(CollisionObject.single("glass", Cylinder(0.03, 0.12), stands))
scene = scene.with_attached(
    "glass", "panda_hand_tcp", ("panda_hand", "panda_leftfinger", "panda_rightfinger")
)

# The glass may lean by 0.15 rad (8.6 deg) about the world's x and y, and turn as it likes about z.
upright = Constraints(
    orientations=(OrientationConstraint(SO3.identity(), (0.15, 0.15, np.pi), link="glass"),)
)
for name, constraints in (("upright", upright), ("without it", Constraints())):
    result = plan(scene, PlanRequest("arm", (PoseGoal(left),), path_constraints=constraints))
    leans = [np.arccos(min(s.frame_pose("glass").rotation.matrix[2, 2], 1)) for s in states(scene, result)]
    print(
        f"{name}: {result.code.name}, {result.trajectory.duration:.2f} s; "
        f"the glass leans by at most {np.rad2deg(max(leans)):.1f} deg"
    )

# A line is a thin box: 1 m long, 7 mm wide and high. (Without the post.)
line = PositionConstraint(((Box(0.007, 1.0, 0.007), SE3.from_xyz(0.5, 0.0, 0.4)),))
scene = scene.without_object("post")
both = Constraints(positions=(line,), orientations=upright.orientations)
result = plan(scene, PlanRequest("arm", (PoseGoal(left),), path_constraints=both))
off = [
    np.hypot(*(s.frame_pose("panda_hand_tcp").translation[[0, 2]] - (0.5, 0.4)))
    for s in states(scene, result)
]
print(f"along a line: {result.code.name}; farthest from the line: {1000 * max(off):.2f} mm")

# What cannot be kept is refused with the constraint, and by how much.
tilted = Constraints(
    orientations=(OrientationConstraint(SO3.from_rpy((0.5, 0, 0)), (0.1, 0.1, 4.0), "glass"),)
)
no = plan(scene, PlanRequest("arm", (PoseGoal(left),), path_constraints=tilted))
print(f"\n{no.code.name}: {no.message}")
