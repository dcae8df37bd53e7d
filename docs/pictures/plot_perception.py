"""Pictures of docs/perception.md: what is seen in a cluttered scene, and a cell's camera.

python -m docs.pictures.plot_perception
"""

from pathlib import Path

import numpy as np
from PIL import Image
from tests.perception.scenes import random_scene

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


if __name__ == "__main__":
    seen()
