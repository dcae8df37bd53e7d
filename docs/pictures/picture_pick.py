"""Animation of the README: `panda_pick` in physics. Needs OpenGL (EGL or OSMesa).

python docs/pictures/picture_pick.py
"""

from pathlib import Path

from PIL import Image

import armcell
from armcell.cell import run_task
from armcell.sim import Camera, render_rgb

FRAME_PERIOD = 0.2  # [s] of cell time between two frames
SPEED = 2.0  # playback relative to cell time
SIZE = (480, 360)  # [px]
CAMERA = Camera.looking_at("readme", (1.85, 0.45, 1.15), (0.35, 0.03, 0.33), fovy_deg=40.0)


class Animation:
    """Renders `CAMERA` at a fixed period of cell time."""

    def __init__(self, live):
        self.live, self.frames, self.due = live, [], 0.0

    def on_state(self, sample):
        if sample.time < self.due:
            return
        self.due = sample.time + FRAME_PERIOD
        world = self.live.driver.world
        picture = Image.fromarray(render_rgb(world, CAMERA))
        self.frames.append(picture.resize(SIZE, Image.Resampling.LANCZOS))

    def on_trajectory(self, time, trajectory):
        pass

    def on_event(self, event):
        pass


def main() -> None:
    cell = armcell.load("panda_pick")
    with cell.connect("sim", seed=1) as live:
        animation = Animation(live)
        live.ctx.observers.append(animation)
        run_task(cell, live, 1, "sim")
    palette = animation.frames[0].quantize(96, method=Image.Quantize.FASTOCTREE)
    frames = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in animation.frames]
    frames[0].save(
        Path(__file__).with_name("pick.gif"),
        save_all=True,
        append_images=frames[1:],
        duration=int(1000 * FRAME_PERIOD / SPEED),
        loop=0,
        optimize=True,
    )


if __name__ == "__main__":
    main()
