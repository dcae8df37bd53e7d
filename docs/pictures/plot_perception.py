"""Pictures of docs/perception.md: what is seen in a cluttered scene, and a cell's camera.

python -m docs.pictures.plot_perception
"""

from pathlib import Path

import numpy as np
from PIL import Image
from tests.perception.scenes import random_scene
from tests.perception.test_mesh_poses import ABOVE, BACK, notched
from tests.perception.test_mesh_poses import seen as images_of

from armcell.core import SE3
from armcell.perception import draw_detections, look
from armcell.sim import DepthNoise, take_image

HERE = Path(__file__).parent


def seen() -> None:
    """Nine things, unknown (left) and from the depth alone, known by name (right)."""
    made = random_scene(1003, 9, DepthNoise.for_stereo(), apart=-0.025)
    unknown = look(made.image, made.world.built.scene)
    known = look(made.image, made.world.built.scene, tuple(made.objects.values()))
    grey = take_image(made.world, made.world.cameras["eye"], rgb=False)
    both = np.hstack([draw_detections(made.image, unknown), draw_detections(grey, known)])
    Image.fromarray(both).resize((1280, 480), Image.Resampling.LANCZOS).save(
        HERE / "perception.png", optimize=True
    )


def ambiguous() -> None:
    """A block with a notch under one end: from above (left), and with a second camera (right)."""
    T = SE3.from_xyz(0.6, 0, 0)
    item, scene, images = images_of(notched(), T, ABOVE, BACK)
    blind = (item.at(SE3.identity()),)
    one, two = look(images[:1], scene, blind), look(images, scene, blind)
    near = np.s_[60:180, 80:240]  # the block is small in the image
    both = np.hstack([draw_detections(images[0], one)[near], draw_detections(images[1], two)[near]])
    Image.fromarray(both).resize((1280, 480), Image.Resampling.LANCZOS).save(
        HERE / "perception_ambiguous.png", optimize=True
    )


if __name__ == "__main__":
    seen()
    ambiguous()
