"""From what a depth camera sees to an obstacle: filter the robot out, keep a map, plan around it.

The cloud is made here (a post and a table seen by an imaginary camera); `armcell.scene.load_points` reads
.ply, .pcd, .xyz and .npy files, `load_octree` reads OctoMap's .bt and .ot.

    python examples/11_clouds_and_octomaps.py
"""

import numpy as np

import armcell
from armcell.collision import remove_robot_points, robot_mask
from armcell.core import JointGoal, JointState, PlanRequest, PointCloud
from armcell.planning import plan
from armcell.scene import CollisionObject, OccupancyMap, PlanningScene, with_octomap

robot = armcell.load_robot("panda")
names = robot.group("arm").joint_names
left = JointState(names, [0.7, 0.2, 0.0, -2.0, 0.0, 2.2, 0.8])
right = JointState(names, [-0.7, 0.2, 0.0, -2.0, 0.0, 2.2, 0.8])
scene = PlanningScene.of(robot).with_state(left).with_padding(0.005)
rng = np.random.default_rng(0)
eye = np.array([2.0, 0.0, 1.2])  # where the camera is, in the world


def seen_post(count: int) -> np.ndarray:
    """The side of a round post that the camera sees."""
    angle = rng.uniform(-np.pi / 2, np.pi / 2, count)
    height = rng.uniform(0.0, 0.6, count)
    return np.column_stack([0.5 + 0.05 * np.cos(angle), 0.05 * np.sin(angle), height])


def seen_robot(count: int) -> np.ndarray:
    """Points on the links, as a camera sees the arm itself."""
    every = rng.uniform((-0.2, -0.3, 0.0), (0.7, 0.6, 1.0), (400_000, 3))
    return every[robot_mask(scene, every, padding=0.0)][:count]


wall = np.column_stack([np.full(20_000, -0.9), rng.uniform(-1, 1, 20_000), rng.uniform(0, 1.5, 20_000)])
cloud = np.vstack([seen_post(20_000), seen_robot(1_000), wall])

# 1. The robot sees itself: those points are taken out (held objects too).
kept = remove_robot_points(scene, cloud, padding=0.02)
print(f"{len(cloud)} points, {len(cloud) - len(kept)} of them are the robot")

# 2. A map of log-odds, as OctoMap's: points make voxels occupied, the rays in front of them free.
seen = OccupancyMap(resolution=0.02).updated(kept, eye)
print(f"the map knows {len(seen.codes)} voxels; the octree has {len(seen.octree().sizes)} cells")

# 3. The octomap is an obstacle like others.
scene = with_octomap(scene, seen.octree())
request = PlanRequest("arm", (JointGoal(right),))
result = plan(scene, request)
print(f"around the post: {result.planner_id}, {result.trajectory.duration:.2f} s,", end=" ")
print(f"{result.min_clearance * 1000:.0f} mm clear")

# 4. The post is taken away: the wall behind it is seen through it, and the rays clear the map.
behind = np.column_stack([np.full(60_000, -0.9), rng.uniform(-0.4, 0.4, 60_000), rng.uniform(-1, 1, 60_000)])
for _ in range(3):
    seen = seen.updated(remove_robot_points(scene, behind), eye)
free = plan(with_octomap(scene, seen.octree()), request)
print(f"after it is gone: {free.planner_id}, {free.trajectory.duration:.2f} s")
front = seen.at(seen_post(5_000))
print(f"{np.mean(front < 0):.0%} of the post's voxels were cleared")

# 5. A cloud may be an obstacle without conversion: balls of one radius around its points.
raw = CollisionObject.single("seen", PointCloud(kept, 0.01))
direct = plan(PlanningScene.of(robot, objects=[raw]).with_state(left), request)
print(f"with {len(kept)} points themselves: {direct.trajectory.duration:.2f} s")
print("clear_octomap:", *with_octomap(scene, None).objects, "no object is left")
