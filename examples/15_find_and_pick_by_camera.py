"""Objects from a depth image: what stands there, how large it is, and a pick of what was seen.

python examples/15_find_and_pick_by_camera.py
"""

import tempfile
from pathlib import Path

import numpy as np

import armcell
from armcell.core import SE3, Box, Cylinder, Sphere
from armcell.perception import load_image, look, pose_error, save_image
from armcell.scene import CollisionObject, PlanningScene
from armcell.sim import Camera, DepthNoise, SimWorld, look_at, take_image

# 1. Three things on a table, and a camera with the noise of a real one.
things = [
    CollisionObject.single("block", Box(0.05, 0.08, 0.04), SE3.from_xyz_rpy((0.5, 0.1, 0.02), (0, 0, 0.5))),
    CollisionObject.single("can", Cylinder(0.033, 0.11), SE3.from_xyz(0.6, -0.1, 0.055)),
    CollisionObject.single("ball", Sphere(0.03), SE3.from_xyz(0.45, -0.15, 0.03)),
]
table = CollisionObject.single("table", Box(1.2, 1.2, 0.04), SE3.from_xyz(0.6, 0, -0.02))
world = SimWorld(PlanningScene.of(armcell.load_robot("parallel_gripper"), objects=[table, *things]))
camera = Camera(
    "eye", look_at([0.2, -0.5, 0.6], [0.5, 0, 0]), width=320, height=240, noise=DepthNoise.for_stereo()
)
image = take_image(world, camera)
print(f"{image.depth.shape[1]} x {image.depth.shape[0]} pixels, {np.mean(image.depth > 0):.0%} with depth")

# 2. Nothing is known: boxes, cylinders and balls are fitted, with their sizes.
for seen in look(image).objects:
    if seen.T_world_object is not None:
        x, y, z = seen.T_world_object.translation * 1000
        print(
            f"  {seen.name}: at {x:.1f} {y:.1f} {z:.1f} mm, {seen.shapes[0][0]}, rms {seen.rms * 1000:.1f} mm"
        )

# 3. Shapes are known, places are not: found by name.
known = [item.at(SE3.identity()) for item in things]
sight = look(image, known=known)
for item in things:
    position, angle = pose_error(item.shapes, sight[item.name].T_world_object, item.T_world_object)
    print(f"{item.name} found, {position * 1000:.2f} mm and {np.rad2deg(angle):.2f} deg off")

# 4. The same from files: camera info as ROS writes it, colors and depth as PNG.
with tempfile.TemporaryDirectory() as folder:
    save_image(Path(folder, "shot"), image)
    again = look(load_image(Path(folder, "shot.yaml")), known=known)
print("from files:", ", ".join(sorted(item.name for item in again.objects if item.known)))

# 5. Why not: a thing that is not there, and a camera that has frozen.
plate = CollisionObject.single("plate", Box(0.2, 0.2, 0.01))
print("why not:", look(image, known=[*known, plate]).message)
print("why not:", look(image, known=known, now=image.time + 3.0).message)

# 6. A pick whose poses come from the camera only: the planner does not know where the cube is.
cell = armcell.load("six_axis_camera")
with cell.connect(seed=1) as live:
    print("known before:", ", ".join(live.scene().objects))
    print("look:", live.look("above").code.name)
    true, seen = live.driver.world.object_pose("cube"), live.scene().object("cube").T_world_object
    print(f"the camera is {np.linalg.norm(true.translation - seen.translation) * 1000:.2f} mm off")
    print("pick:", live.arm.pick("cube").code.name)
    print("place:", live.arm.place("cube", on="mat").code.name)
