"""Pictures of docs/two_arms.md: the tasks in physics, and step responses. Needs a GL (EGL or OSMesa).

python docs/pictures/picture_two_arms.py
"""

from pathlib import Path

import numpy as np
from PIL import Image

import armcell
from armcell.records.plots import response_plot
from armcell.sim import render_rgb
from armcell.sim.gain_files import with_gains
from armcell.sim.step_response import step_responses

HERE = Path(__file__).parent
PICTURES = {
    "two_arms.png": {"dual_ur10_rod": "move and turn", "dual_ur10_sort": "lower", "dual_ur10_screw": "screw"},
    "many_arms.png": {"three_ur5_table": "lower", "four_ur5_square": "lower"},
}


class Shot:
    """Takes one picture at the end of the first stage whose name ends so."""

    def __init__(self, live, stage):
        self.live, self.stage, self.picture = live, stage, None

    def on_state(self, sample):
        pass

    def on_trajectory(self, time, trajectory):
        pass

    def on_event(self, event):
        ends = event.kind == "stage" and event.data.get("phase") == "end" and event.text.endswith(self.stage)
        if ends and self.picture is None:
            world = self.live.driver.world
            self.picture = render_rgb(world, next(iter(world.cameras.values())))


def tasks(file: str, shots: dict[str, str]) -> None:
    from armcell.cell import run_task

    pictures = []
    for name, stage in shots.items():
        cell = armcell.load(name)
        with cell.connect("sim", seed=1) as live:
            shot = Shot(live, stage)
            live.ctx.observers.append(shot)
            run_task(cell, live, 1, "sim")
        pictures.append(np.asarray(shot.picture)[60:440, 80:560])
    Image.fromarray(np.hstack(pictures)).save(HERE / file, optimize=True)


def steps() -> None:
    cell = armcell.load("dual_ur10")
    joints = cell.model.group("left_arm").joint_names[:3]
    parts = []
    for gains in ("the cell's own", "tutorial"):
        settings = cell.physics if gains != "tutorial" else with_gains(cell.physics, gains, cell.model)
        found = step_responses(cell.scene(), joints, settings, np.deg2rad(5), 2.0)
        curves = {r.joint: r.positions / r.size for r in found}
        title = f"{gains}: kp {settings.arm_kp:g}, ki {settings.arm_ki:g}, kv {settings.arm_kv:g}"
        file = HERE / "steps.tmp.png"
        file.write_bytes(response_plot(found[0].times, curves, title))
        parts.append(np.asarray(Image.open(file).convert("RGB")))
        file.unlink()
    Image.fromarray(np.vstack(parts)).resize(
        (parts[0].shape[1] * 2 // 3, 2 * parts[0].shape[0] * 2 // 3)
    ).save(HERE / "step_responses.png", optimize=True)


if __name__ == "__main__":
    steps()
    for file, shots in PICTURES.items():
        tasks(file, shots)
