"""Draws docs/pictures/grasping.png: library objects, each with the best grasp of a Panda's hand.

python docs/pictures/plot_grasping.py
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from armcell.core import SE3, Box
from armcell.grasping import grasp_candidates, hand_of
from armcell.model import MountedRobot, compose, hand_alone, load_robot
from armcell.scene import CollisionObject, PlanningScene, library_object
from armcell.sim import Camera, SimWorld, render_rgb

KINDS = ("box", "can", "bottle", "mug", "l_bracket", "rod", "bolt", "tray")
SIZE = 240


def picture(kind: str) -> Image.Image:
    model = load_robot("panda")
    gripper, item = model.gripper(), library_object(kind)
    grasp = grasp_candidates(item, hand_of(model, gripper))[0][0]
    alone = hand_alone(model, gripper)
    T_tcp_root = PlanningScene.of(alone).frame_pose(gripper.tcp_link).inverse()
    hand = compose("hand", [MountedRobot(alone, T_parent_root=grasp.T_object_tcp @ T_tcp_root)])
    floor = CollisionObject.single(
        "floor", Box(3, 3, 0.02), SE3.from_xyz(0, 0, -0.0105), color=(0.86, 0.86, 0.84, 1.0)
    )
    scene = PlanningScene.of(hand, objects=[floor, replace(item, name="object")])
    joint = gripper.joint_position(grasp.width)
    scene = scene.with_positions(np.full(hand.dof, joint))
    low, high = item.bounds()
    middle = (low + high) / 2
    eye = middle + np.array([0.32, -0.30, 0.26])
    camera = Camera.looking_at(
        "view", tuple(eye), tuple(middle + np.array([0.0, 0.0, 0.05])), width=SIZE, height=SIZE, fovy_deg=38
    )
    return Image.fromarray(render_rgb(SimWorld(scene), camera))


def main() -> None:
    sheet = Image.new("RGB", (4 * SIZE, 2 * SIZE))
    for i, kind in enumerate(KINDS):
        sheet.paste(picture(kind), (SIZE * (i % 4), SIZE * (i // 4)))
    sheet.quantize(128).save(Path(__file__).with_name("grasping.png"), optimize=True)


if __name__ == "__main__":
    main()
