"""Pictures of docs/grasping.md: library objects, each with the best grasp of a Panda's hand (grasping.png),
and the candidates on a mug beside the grasp of its rim in physics (grasping_rim.png).

python docs/pictures/plot_grasping.py
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

import armcell
from armcell.core import SE3, Box
from armcell.grasping import Grasp, grasp_candidates, hand_of
from armcell.model import MountedRobot, compose, hand_alone, load_robot
from armcell.scene import CollisionObject, PlanningScene, library_object
from armcell.sim import Camera, SimWorld, render_rgb
from armcell.tasks import pick

KINDS = ("box", "can", "bottle", "mug", "l_bracket", "rod", "bolt", "tray")
SIZE = 240
WIDE = (480, 400)  # [px]
WALL = 0.01  # [m] a wider grasp also holds the handle
# wider than the hand opens
MUG = library_object(
    "mug", "mug", SE3.from_xyz_rpy((0.5, -0.15, 0.0), (0, 0, 0.6)), sizes={"radius": 0.045, "height": 0.09}
)


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


def bracket(name: str, grasp: Grasp, color: tuple[float, float, float, float]) -> CollisionObject:
    """The open fingers of a grasp, the bar between them and the approach direction, as thin boxes."""
    thin, long, half = 0.0012, 0.02, grasp.opening / 2
    bars = [(Box(thin, thin, long), SE3.from_xyz(0, side * half, -long / 2)) for side in (-1, 1)]
    bars.append((Box(thin, 2 * half, thin), SE3.from_xyz(0, 0, -long)))
    bars.append((Box(thin, thin, long), SE3.from_xyz(0, 0, -1.5 * long)))
    return CollisionObject(name, tuple(bars), MUG.T_world_object @ grasp.T_object_tcp, color=color)


def rim() -> None:
    """Every third candidate on a mug, from the worst (red) to the best (green), and the mug in the hand after
    a pick by its rim in physics.
    """
    cell = armcell.load("panda_pick")
    gripper, scene = cell.model.gripper(), cell.scene()
    for name in ("cube", "wall", "post", "tray"):
        scene = scene.without_object(name)
    scene = scene.with_object(MUG)
    grasps, _ = grasp_candidates(MUG, hand_of(cell.model, gripper))
    shown = scene
    for i in range(0, len(grasps), 3):
        good = 1 - i / len(grasps)  # the best grasp is the first
        shown = shown.with_object(bracket(f"grasp {i}", grasps[i], (1 - good, 0.75 * good, 0.1, 1.0)))
    low, high = MUG.bounds()
    middle = MUG.T_world_object.apply(((low + high) / 2)[None])[0]
    left = _close_up(SimWorld(shown), middle + np.array([0.0, 0.0, 0.01]))
    with cell.connect("sim", scene=scene) as live:
        wide = tuple(grasp.name for grasp in grasps if grasp.width > WALL)
        outcome = pick(live.ctx, "mug", gripper, excluded=wide)
        assert outcome.ok, outcome.message
        live.arm.hold(5.0)
        world = live.driver.world
        assert world is not None
        right = _close_up(world, live.scene().frame_pose(gripper.tcp_link).translation)
    sheet = Image.new("RGB", (2 * WIDE[0], WIDE[1]))
    sheet.paste(left, (0, 0))
    sheet.paste(right, (WIDE[0], 0))
    sheet.quantize(128).save(Path(__file__).with_name("grasping_rim.png"), optimize=True)


def _close_up(world: SimWorld, middle: np.ndarray) -> Image.Image:
    eye = middle + np.array([0.24, -0.26, 0.15])
    camera = Camera.looking_at("view", tuple(eye), tuple(middle), width=WIDE[0], height=WIDE[1], fovy_deg=34)
    return Image.fromarray(render_rgb(world, camera))


def main() -> None:
    rim()
    sheet = Image.new("RGB", (4 * SIZE, 2 * SIZE))
    for i, kind in enumerate(KINDS):
        sheet.paste(picture(kind), (SIZE * (i % 4), SIZE * (i // 4)))
    sheet.quantize(128).save(Path(__file__).with_name("grasping.png"), optimize=True)


if __name__ == "__main__":
    main()
