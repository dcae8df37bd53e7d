"""Pictures of unity/README.md and docs/with_unity.md. Needs Mono, and a GL (EGL or OSMesa).

python -m docs.pictures.plot_unity

Nothing here is a picture of Unity: diagrams, armcell's own renderer, curves of the package under Mono.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from PIL import Image
from tests.unity.mono import Player
from tests.unity.test_play import grip_lines

from armcell.cell import load
from armcell.model import load_urdf
from armcell.ros.unity import export_unity
from armcell.scene import PlanningScene
from armcell.sim import Camera, SimWorld, render_rgb

HERE = Path(__file__).parent
OUT = HERE.parents[1] / "unity" / "Documentation~"
BLUE, ORANGE, GREY = "#2a5d8f", "#c9642b", "#666666"


def _box(ax, xy, width, height, title, lines, color):
    ax.add_patch(
        plt.Rectangle(xy, width, height, fill=True, facecolor="#f6f6f4", edgecolor=color, linewidth=1.6)
    )
    x, top = xy[0] + width / 2, xy[1] + height
    ax.text(x, top - 0.35, title, ha="center", va="top", weight="bold", color=color, fontsize=11)
    ax.text(x, top - 0.95, "\n".join(lines), ha="center", va="top", fontsize=8.5, linespacing=1.5)


def arrangement() -> None:
    """Who is what, and what goes over the wire."""
    fig, ax = plt.subplots(figsize=(9, 3.9))
    _box(
        ax, (0, 0), 4.6, 5, "Unity: the simulator",
        ["Joint Map", "Joint State and Object Pose Publisher", "Clock Publisher", "Trajectory Executor",
         "Gripper Controller",
         "Planning Scene Exporter", "Contact Publisher", "PhysX"], BLUE,
    )  # fmt: skip
    _box(
        ax, (8.4, 0), 4.6, 5, "armcell: the planner",
        ["armcell serve CELL --unity --plan-only", "ROS-TCP server, port 10000", "planner, proven paths",
         "grasp server: /grasp", "move_group's services", "no ROS installed"], ORANGE,
    )  # fmt: skip
    there = [
        "/joint_states",
        "/object_pose",
        "/clock",
        "/trajectory_status",
        "/gripper_status",
        "/collision_object",
    ]
    back = ["/planned_trajectory", "/gripper_command"]
    for i, (name, right) in enumerate([(n, True) for n in there] + [(n, False) for n in back]):
        y = 4.55 - 0.58 * i
        ends = ((4.75, y), (8.25, y)) if right else ((8.25, y), (4.75, y))
        color = BLUE if right else ORANGE
        ax.annotate("", ends[1], ends[0], arrowprops={"arrowstyle": "->", "color": color})
        ax.text(6.5, y + 0.06, name, ha="center", va="bottom", fontsize=8.5, family="monospace")
    _finish(fig, ax, (-0.1, 13.1), (-0.1, 5.1), "arrangement.png")


def axes() -> None:
    """ROS's axes and Unity's, with the golden vector."""
    fig, panels = plt.subplots(1, 2, figsize=(9, 3.3))
    sides = (
        ("ROS: right-handed, z up", {"x forward": (0.85, 0.5), "y left": (-0.9, 0.35), "z up": (0, 1.1)},
         "(0.5, -0.1, 0.025) m, yaw -30 deg"),
        ("Unity: left-handed, y up", {"z forward": (0.85, 0.5), "x right": (0.9, -0.35), "y up": (0, 1.1)},
         "(0.1, 0.025, 0.5), Euler (0, 30, 0) deg"),
    )  # fmt: skip
    for ax, (title, arrows, same) in zip(panels, sides):
        for (label, (x, y)), color in zip(arrows.items(), ("#b03030", "#2f8f3a", "#2a4fa0")):
            ax.annotate("", (x, y), (0, 0), arrowprops={"arrowstyle": "-|>", "color": color, "linewidth": 2})
            ax.text(1.12 * x, 1.12 * y, label, color=color, ha="center", va="center", fontsize=9)
        ax.set_title(title, fontsize=11)
        ax.text(0, -0.75, f"the same pose: {same}", ha="center", fontsize=9, color=GREY)
        ax.set(xlim=(-1.4, 1.6), ylim=(-0.9, 1.35), aspect="equal")
        ax.axis("off")
    fig.savefig(OUT / "axes.png", dpi=110, bbox_inches="tight")
    plt.close(fig)


def cell(folder: Path) -> None:
    """What was exported, read back and drawn: looks on the left, what collides on the right."""
    source, export = load("panda_table"), None
    export = export_unity(source, folder)
    model, scene = load_urdf(export.cell / "robot.urdf"), source.scene()
    bare = {n: replace(link, visuals=()) for n, link in model.links.items()}
    camera = Camera.looking_at(
        "picture", (1.15, -0.95, 0.85), (0.22, 0.02, 0.30), fovy_deg=42.0, width=480, height=400
    )
    pictures = []
    for robot in (model, replace(model, links=bare)):
        shown = PlanningScene.of(robot, objects=list(scene.objects.values())).with_positions(scene.positions)
        pictures.append(render_rgb(SimWorld(shown, source.physics), camera))
    Image.fromarray(np.hstack(pictures)).save(OUT / "cell.png", optimize=True)


def grips(folder: Path) -> None:
    """The cube's height while it slips by 10 mm/s, in the three grip modes, with the package under Mono."""
    source = load("panda_table")
    scene = export_unity(source, folder).cell / "scene.json"
    (folder / "mono").mkdir()
    player = Player(folder / "mono", False)
    fig, ax = plt.subplots(figsize=(9, 3.0))
    for mode, color in (("friction", GREY), ("weld", BLUE), ("hybrid", ORANGE)):
        rows = player.play(scene, [f"mode {mode}", *grip_lines(lambda: player, source, 0.01)], 7.0)
        poses = player.received(rows, "/object_pose")
        ax.plot([t for t, _ in poses], [m.pose.position.z * 1000 for _, m in poses], color=color, label=mode)
    for t, text in ((1.5, "close, 30 N"), (3.0, "lift"), (6.0, "open")):
        ax.axvline(t, color="#cccccc", linewidth=1)
        ax.text(t + 0.05, 228, text, fontsize=9, color=GREY, va="top")
    ax.set(xlabel="time [s]", ylabel="cube's height [mm]", xlim=(0, 7))
    ax.legend(loc="center left", frameon=False)
    ax.spines[["top", "right"]].set_visible(False)
    fig.savefig(OUT / "grips.png", dpi=110, bbox_inches="tight")
    plt.close(fig)


def _finish(fig, ax, x, y, name) -> None:
    ax.set(xlim=x, ylim=y)
    ax.axis("off")
    fig.savefig(OUT / name, dpi=110, bbox_inches="tight")
    plt.close(fig)


if __name__ == "__main__":
    OUT.mkdir(exist_ok=True)
    arrangement()
    axes()
    with TemporaryDirectory() as there:
        cell(Path(there))
        grips(Path(there))
    (HERE / "unity.png").write_bytes((OUT / "arrangement.png").read_bytes())
