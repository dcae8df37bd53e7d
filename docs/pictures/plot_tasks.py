"""Pictures of docs/tasks.md: a bin as it stands, and what the picking sees of it.

python -m docs.pictures.plot_tasks
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import armcell
from armcell.grasping import hand_of, top_down_grasps
from armcell.perception import height_map, label_pieces
from armcell.sim import SimWorld, render_rgb, take_image

HERE = Path(__file__).parent
FLOOR = 0.2185  # [m] of the bin in the cell bin_clearing
LOW, HIGH = (0.49, -0.55), (0.91, -0.09)  # [m] inside of its walls


def bin_clearing() -> None:
    """The cell, and the map of heights with the ten best grasps."""
    cell = armcell.load("bin_clearing")
    scene = cell.scene(0)
    world = SimWorld(scene, cell.physics, cell.cameras)
    image = take_image(world, world.cameras["above_bin"], rgb=False)
    room = 0.05
    seen = height_map(image, scene, (LOW[0] - room, LOW[1] - room), (HIGH[0] + room, HIGH[1] + room), FLOOR)
    labels = label_pieces(seen, seen.cells_within(LOW, HIGH), FLOOR + 0.007)
    hand = hand_of(scene.model, scene.model.gripper())
    grasps = top_down_grasps(seen, labels, FLOOR, hand, 30.0)[:10]
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4.2), width_ratios=[1.35, 1])
    left.imshow(render_rgb(world, world.cameras["overview"]))
    left.axis("off")
    extent = (seen.origin[1], seen.origin[1] + seen.resolution * seen.heights.shape[1],
              seen.origin[0] + seen.resolution * seen.heights.shape[0], seen.origin[0])  # fmt: skip
    right.imshow((seen.heights - FLOOR) * 1000, extent=extent, cmap="gray", vmin=0, vmax=90)
    for k, grasp in enumerate(grasps):
        at, y = grasp.T_object_tcp.translation[:2], grasp.T_object_tcp.rotation.matrix[:2, 1]
        across = np.array([-y[1], y[0]]) * 0.011
        for side in (-1, 1):
            pad = at + side * y * grasp.opening / 2
            ends = np.array([pad - across, pad + across])
            right.plot(ends[:, 1], ends[:, 0], color="tab:red" if k == 0 else "tab:orange", linewidth=2)
    right.axis("off")
    figure.tight_layout(pad=0.3)
    figure.savefig(HERE / "bin_clearing.png", dpi=75)


if __name__ == "__main__":
    bin_clearing()
