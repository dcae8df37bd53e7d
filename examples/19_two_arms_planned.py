"""Two UR10: together on one clock, one beside the other's running motion, and two tips to one point.

python examples/19_two_arms_planned.py
"""

import numpy as np

import armcell
from armcell.collision import without_arms
from armcell.core import SE3, PlanRequest, PoseGoal
from armcell.planning import RunningMotion, plan, plan_around_moving_arms, plan_synchronized

scene = armcell.load("dual_ur10").scene()
speed = {"velocity_scaling": 0.6, "acceleration_scaling": 0.25}


def down_at(x, y, z=1.05):
    """A gripper that points down."""
    return PoseGoal(SE3.from_xyz_rpy((x, y, z), (np.pi, 0.0, 0.0)))


# Both start and arrive together; that the timed pair keeps 20 mm apart is proven.
both = plan_synchronized(
    scene, {"left_arm": down_at(-0.1, -0.1), "right_arm": down_at(0.25, 0.1)},
    template=PlanRequest("left_arm", (), **speed),
)  # fmt: skip
print(f"together: {both.how}, {both.trajectory.duration:.2f} s, proven in {1000 * both.recheck_time:.1f} ms")

# Two tips to one point: refused, with the pair that would touch.
print("refused:", plan_synchronized(scene, {"left_arm": down_at(0, 0), "right_arm": down_at(0, 0)}).message)

# They change places while the right one is on its way: its motion is an obstacle in space and time.
there = {"left_arm": (0.3, -0.1), "right_arm": (-0.3, 0.1)}
for group, other in (("left_arm", "right_arm"), ("right_arm", "left_arm")):
    first = plan(without_arms(scene, other), PlanRequest(group, (down_at(*there[group]),)))
    scene = scene.with_state(first.trajectory.end)
right = PlanRequest("right_arm", (down_at(0.3, 0.1),), velocity_scaling=0.3, acceleration_scaling=0.1)
running = RunningMotion(plan(without_arms(scene, "left_arm"), right).trajectory, start=0.0)
request = PlanRequest("left_arm", (down_at(-0.3, -0.1),), **speed)
left = plan_around_moving_arms(scene, request, {"right_arm": running})
print(f"beside: {left.evidence['beside']}, {left.trajectory.duration:.2f} s", end=" ")
print(f"while the other takes {running.end:.2f} s")
