"""A camera keeps the planning scene true while the cell runs: something comes across the path.

python examples/16_live_octomap.py
"""

import tempfile
from pathlib import Path

import armcell
from armcell.core import SE3

CELL = """
robot: panda
start: {arm: home, hand: open}
objects:
  table: {box: [1.2, 1.8, 0.04], pose: [0.4, 0, -0.021]}
  post: {box: [0.08, 0.08, 0.7], pose: [3, 3, 0.35], movable: true}
cameras:
  eye: {eye: [1.6, -0.9, 1.2], target: [0.4, 0, 0.3], width: 320, height: 240, fovy_deg: 60, noise: stereo}
"""
LEFT = [0.9, 0.3, 0, -1.9, 0, 2.2, 0.8]
RIGHT = [-0.9, 0.3, 0, -1.9, 0, 2.2, 0.8]

folder = tempfile.TemporaryDirectory()
Path(folder.name, "cell.yaml").write_text(CELL)
cell = armcell.load(folder.name)


class Comes:
    """Puts the post into the way, 0.3 s into the first motion that it watches."""

    def __init__(self, world):
        self.world, self.began, self.done = world, None, False

    def on_state(self, sample):
        if self.began is not None and not self.done and sample.time > self.began + 0.3:
            self.world.set_object_pose("post", SE3.from_xyz(0.5, -0.15, 0.35))
            self.done = True

    def on_event(self, event):
        pass

    def on_trajectory(self, time, trajectory):
        self.began = time if self.began is None else self.began


with cell.connect() as live:
    # The planner does not know of the post: it is in physics, and in what the camera sees.
    live.change_scene(lambda scene: scene.without_object("post"))
    watch = live.watch("eye", rate=15)  # robot, held objects and the table are taken out of the map
    print("to the left:", live.arm.move_to(LEFT).code.name, f"({len(watch.updates)} pictures so far)")
    live.ctx.observers.append(Comes(live.driver.world))
    print("to the right:", live.arm.move_to(RIGHT).code.name)
    print("why:", watch.stopped)
    for attempt in range(4):  # a side of it may come into view only on the way
        live.ctx.advance(0.4)
        if live.arm.move_to(RIGHT):
            print(f"around it: arrived, attempt {attempt + 1}")
            break
    touched = [c for c in live.driver.unwanted_contacts() if "panda" in c.body_a + c.body_b]
    print(f"contacts of the robot: {len(touched)}")
    cells = watch.map.octree.centers
    live.driver.world.set_object_pose("post", SE3.from_xyz(3, 3, 0.35))
    live.ctx.advance(1.0)  # rays go through where it was, but for those that end in the open sky
    low = cells[cells[:, 2] < 0.3]  # before the table
    print(f"after it is gone: {(watch.map.map.at(low) > 0).sum()} of its {len(low)} lower voxels are left")
    cpu = sorted(update.cpu_time for update in watch.updates)[len(watch.updates) // 2]
    print(f"one picture into the map: {cpu * 1000:.0f} ms of processor time")
folder.cleanup()
