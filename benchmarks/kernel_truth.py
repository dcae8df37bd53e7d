"""`python -m benchmarks.kernel_truth`: does the kernel ever call free what touches by exact meshes?

MotionBenchMaker's scenes; half of the configurations are drawn within the joint limits, half are brought to
within a thousandth of the way between a free and a touching one, where a checker that errs errs. What
the kernel calls free, pinocchio and coal look at with the meshes as they are, read without armcell.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from armcell.cli.bench_mbm import scene_of
from armcell.collision.kernel.checker import KernelChecker
from armcell.model import load_robot
from benchmarks.planning.pinocchio_world import PinocchioWorld
from benchmarks.planning.problems import load

HALVINGS = 10


def main(arguments: list[str] | None = None) -> int:
    """Look at the samples; 1 if one that the kernel calls free touches."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.kernel_truth", description=__doc__)
    default = Path(os.environ.get("MBM") or Path(__file__).parents[2] / "shared" / "data" / "mbm")
    parser.add_argument("--mbm", type=Path, default=default, help="folder of MotionBenchMaker's problems")
    parser.add_argument("--robots", nargs="+", default=["panda", "ur5", "baxter"])
    parser.add_argument("--samples", type=int, default=1_000_000, help="configurations per robot")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    if not (options.mbm / "mbm_panda.json.gz").is_file():
        print(f"no problems in {options.mbm}; say where they are with MBM=/path", file=sys.stderr)
        return 2
    table = Table(box=None, pad_edge=False, header_style="bold")
    for title in ("robot", "samples", "free by kernel", "of these touching", "not free, touching nothing"):
        table.add_column(title, justify="left" if title == "robot" else "right")
    wrong = 0
    for name in options.robots:
        samples, free, touching, refused = look(options.mbm, name, options.samples, options.seed)
        wrong += touching
        table.add_row(name, f"{samples:,}", f"{free:,}", f"{touching:,}", f"{refused:,}")
    Console(width=None if sys.stdout.isatty() else 120, highlight=False).print(table)
    return 1 if wrong else 0


def look(folder: Path, name: str, samples: int, seed: int) -> tuple[int, int, int, int]:
    """Samples, those free by the kernel, of these touching by meshes, not free but touching nothing."""
    robot, problems = load(folder, name)
    model, world = load_robot(robot.urdf), PinocchioWorld(robot)
    columns = model.columns(robot.joints)
    lower, upper = np.maximum(model.lower[columns], -np.pi), np.minimum(model.upper[columns], np.pi)
    rng = np.random.default_rng(seed)
    done = free = touching = refused = 0
    for problem in track(problems, f"{name:8}", transient=True):
        checker = KernelChecker(scene_of(model, robot.fixed, {"obstacles": problem.obstacles}), robot.joints)
        world.set_problem(problem)
        drawn = rng.uniform(lower, upper, (-(-samples // len(problems) // 2), len(columns)))
        kernel = np.array([not checker.touches(q) for q in drawn])
        near = [
            (q, is_free)
            for _ in range(len(drawn) // 2)
            if kernel.any() and not kernel.all()
            for q, is_free in brought_near(checker, *(rng.choice(drawn[kernel == k]) for k in (True, False)))
        ]
        for q, is_free in [*zip(drawn, kernel, strict=True), *near]:
            meets = world.touches(q)
            done, free = done + 1, free + bool(is_free)
            touching += bool(is_free and meets)
            refused += bool(not is_free and not meets)
    return done, free, touching, refused


def brought_near(checker: KernelChecker, free: np.ndarray, touching: np.ndarray) -> list:
    """A free and a touching configuration on the line between two, close together."""
    for _ in range(HALVINGS):
        middle = (free + touching) / 2
        if checker.touches(middle):
            touching = middle
        else:
            free = middle
    return [(free, True), (touching, False)]


if __name__ == "__main__":
    sys.exit(main())
