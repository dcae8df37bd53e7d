"""The pictures of docs/kernel.md: a sphere cover, and the intervals of a proof.

Run from the repository: .venv/bin/python docs/pictures/plot_kernel.py
"""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from armcell import load_robot
from armcell.collision.kernel.checker import KernelChecker
from armcell.collision.kernel.cover import cover
from armcell.core import SE3, Box
from armcell.scene import CollisionObject, PlanningScene

HERE = Path(__file__).parent
ROBOT, GROUP = "panda", "arm"


def picture_of_cover() -> None:
    """One link's mesh beside its spheres."""
    model = load_robot(ROBOT)
    shape = model.links["panda_hand"].collisions[0].shape
    found = cover(shape, 0.010)
    figure = plt.figure(figsize=(8, 3.4))
    for k, title in enumerate(("the hand's mesh", f"{len(found.centers)} spheres that hold it")):
        axes = figure.add_subplot(1, 2, k + 1, projection="3d")
        x, y, z = shape.vertices.T
        if k == 0:
            axes.plot_trisurf(x, y, z, triangles=shape.faces, color="#9fb8d0", edgecolor="#5b7896", lw=0.2)
        u, v = np.mgrid[0 : 2 * np.pi : 14j, 0 : np.pi : 8j]
        if k == 1:
            for c, r in zip(found.centers, found.outer, strict=True):
                axes.plot_surface(
                    c[0] + r * np.cos(u) * np.sin(v), c[1] + r * np.sin(u) * np.sin(v), c[2] + r * np.cos(v),
                    color="#e0a96d", alpha=0.35, lw=0,
                )  # fmt: skip
        axes.set_box_aspect((np.ptp(x), np.ptp(y), np.ptp(z)))
        axes.set_xlim(x.min() - 0.01, x.max() + 0.01)
        axes.set_ylim(y.min() - 0.01, y.max() + 0.01)
        axes.set_zlim(z.min() - 0.01, z.max() + 0.01)
        axes.view_init(18, 60)
        axes.set_axis_off()
        axes.set_title(title, fontsize=10)
    figure.tight_layout()
    figure.savefig(HERE / "kernel_cover.png", dpi=90)


def picture_of_proof() -> None:
    """How close an arm comes to a shelf on a straight motion, and how finely the proof had to look."""
    model = load_robot(ROBOT)
    names = model.group(GROUP).joint_names
    shelf = CollisionObject.single("shelf", Box(0.4, 0.6, 0.02), SE3.from_xyz(0.55, 0.0, 0.30))
    home = model.default_positions()
    columns = model.columns(names)
    checker = KernelChecker(PlanningScene.of(model, home, [shelf]), names)
    a, b = home[columns].copy(), home[columns].copy()
    a[0], b[0] = -1.5, 1.5
    height = _lowest_that_passes(checker, a, b)
    a[1] = b[1] = height
    t = np.linspace(0, 1, 400)
    gap = [checker.exact.nearest(a + x * (b - a)).distance for x in t]
    looked = _intervals(checker, a, b)
    figure, (top, bottom) = plt.subplots(2, 1, sharex=True, figsize=(8, 4), height_ratios=(2, 1))
    top.fill_between(t, 0, np.array(gap) * 1000, color="#9fb8d0")
    top.set_ylabel("smallest distance [mm]")
    for middle, half, level in looked:
        bottom.barh(
            level, 2 * half, left=middle - half, height=0.8, color="#e0a96d", edgecolor="#8a5a20", lw=0.4
        )
    bottom.invert_yaxis()
    bottom.set_ylabel("times halved")
    bottom.set_xlabel("along the motion")
    figure.tight_layout()
    figure.savefig(HERE / "kernel_proof.png", dpi=90)


def _lowest_that_passes(checker: KernelChecker, a: np.ndarray, b: np.ndarray) -> float:
    """Shoulder angle at which the swing over the shelf is just proven free."""
    best = float(a[1])
    for angle in np.arange(a[1], 1.2, 0.01):
        a[1] = b[1] = angle
        if not checker.certify([a, b], evidence=False).free:
            break
        best = float(angle)
    return best


def _intervals(checker: KernelChecker, a: np.ndarray, b: np.ndarray) -> list[tuple[float, float, int]]:
    """(middle, half width, times halved) of the intervals that were proven in one step each."""
    found, waiting = [], [((k + 0.5) / 16, 0.5 / 16, 0) for k in range(16)]
    while waiting:
        middle, half, level = waiting.pop()
        if _one_step(checker, a, b, middle, half) or level > 10:
            found.append((middle, half, level))
        else:
            waiting += [(middle + s * half / 2, half / 2, level + 1) for s in (-1, 1)]
    return found


def _one_step(checker: KernelChecker, a: np.ndarray, b: np.ndarray, middle: float, half: float) -> bool:
    """Whether one interval is proven without cutting it: its own proof needs one block of lanes."""
    ends = [a + (middle - half) * (b - a), a + (middle + half) * (b - a)]
    before = int(checker.state[0])
    free = checker.certify(ends, evidence=False).free
    return free and int(checker.state[0]) - before == 1


if __name__ == "__main__":
    picture_of_cover()
    picture_of_proof()
