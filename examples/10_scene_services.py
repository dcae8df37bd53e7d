"""Change a scene in one go, also while an arm moves; frames on objects, holding by contact, reused plans.

python examples/10_scene_services.py
"""

import tempfile
import threading
from pathlib import Path

import numpy as np

import armcell
from armcell.collision import attached_by_contact, touching_links
from armcell.core import SE3, Box, Cylinder, InputError, JointGoal, JointState, PlanRequest
from armcell.planning import PlanLibrary, plan_around_moving_obstacles
from armcell.scene import (
    AddObject,
    AllowCollision,
    CollisionObject,
    MovingObject,
    PlanningScene,
    RemoveObject,
    SceneDiff,
    SetPadding,
    load_scene_file,
    save_scene_file,
)

robot = armcell.load_robot("panda")
scene = PlanningScene.of(robot)

# A diff is applied as a whole. Poses may be given in any frame, here on a table's named corner.
table = CollisionObject.single(
    "table", Box(0.5, 0.8, 0.02), SE3.from_xyz(0.6, 0.0, 0.2), subframes={"middle": SE3.from_xyz(0, 0, 0.01)}
)
mug = CollisionObject.single("mug", Cylinder(0.03, 0.1), SE3.from_xyz(0.0, 0.2, 0.051), color=(1, 0, 0, 1))
scene = scene.apply(
    SceneDiff.of(AddObject(table), AddObject(mug, frame="table/middle"), SetPadding(0.005))
)  # fmt: skip
x, y, z = scene.frame_pose("mug").translation
print(f"the mug stands at {x:.2f}, {y:.2f}, {z:.3f}; the scene has", *scene.objects)
try:
    scene.apply(SceneDiff.of(RemoveObject("mug"), AllowCollision("mgu", "panda_hand")))
except InputError as error:
    print("refused:", error)
print("the mug is still there:", "mug" in scene.objects)

# The fingers close on a cube: what holds it is found from contact, so that the start is not "in collision".
fingers = JointState(("panda_finger_joint1",), [0.02])
cube = CollisionObject.single("cube", Box(0.03, 0.04, 0.03), SE3.from_xyz(0, 0, 0), movable=True)
scene = scene.with_state(fingers).apply(SceneDiff.of(AddObject(cube, frame="panda_hand_tcp")))
print("\ntouching the cube:", *sorted(touching_links(scene, "cube")))
scene = attached_by_contact(scene, "cube", "panda_hand")

with tempfile.TemporaryDirectory() as folder:
    # MoveIt's own text format; `armcell.cell.save_objects` writes ours, in YAML.
    save_scene_file(scene.objects.values(), Path(folder, "table.scene"))
    print("saved and loaded:", *(item.name for item in load_scene_file(Path(folder, "table.scene"))))

    # A library proves a stored motion again in the current scene, and repairs it if necessary.
    names = robot.group("arm").joint_names
    left = JointState(names, [0.7, 0.0, 0.0, -2.0, 0.0, 2.2, 0.8])
    right = JointState(names, [-0.7, 0.0, 0.0, -2.0, 0.0, 2.2, 0.8])
    here, request = scene.with_state(left), PlanRequest("arm", (JointGoal(right),))
    library = PlanLibrary(Path(folder, "plans"))
    print("\nfirst:", library.plan(here, request).evidence["library"])
    print("again:", library.plan(here, request).evidence["library"])
    post = CollisionObject.single("post", Box(0.06, 0.06, 0.5), SE3.from_xyz(0.42, 0.0, 0.9))
    print("with a post in the way:", library.plan(here.with_object(post), request).evidence["library"])

# A box comes by on a known way: wait for it or go around, whichever is sooner, proven in time.
ways = (SE3.from_xyz(0.45, 0.0, 2.0), SE3.from_xyz(0.45, 0.0, 0.55), SE3.from_xyz(0.45, 0.0, 2.0))
box = CollisionObject.single("box", Box(0.2, 0.2, 0.3))
moving = MovingObject(box, np.array([-2.0, 1.0, 4.0]), ways)
result = plan_around_moving_obstacles(here, request, [moving])
print(f"\nwith a moving box: {result.evidence['moving']}, done after {result.trajectory.duration:.1f} s")

# A live cell's scene can be changed at any time, from any thread: what comes across a motion stops it.
rod = CollisionObject.single("rod", Box(0.06, 0.06, 0.5), SE3.from_xyz(0.55, 0.1, 0.6))
left, right = ([turn, 0.3, 0.0, -1.9, 0.0, 2.2, 0.8] for turn in (1.2, -0.6))
with armcell.load("panda_pick").connect("fake", time_scale=1.0) as live:
    live.arm.move_to(left)
    threading.Timer(0.5, lambda: live.change_scene(lambda now: now.with_object(rod))).start()
    outcome = live.arm.move_to(right)
    print(f"\n{outcome.code.name}: {outcome.message}")
    print("and around it:", live.arm.move_to(right).code.name)
    live.change_scene(lambda now: now.without_object("rod"))
