"""Objects held in a hand: creep at rest in every built-in cell, and drift while a task carries them.

    python -m benchmarks.holding --seconds 60 --runs 10

Creep is the distance that an object moves in a hand at rest, divided by the time. The loads are a 5 cm
cube of 0.1 and 2 kg and a 25 cm bar of 0.5 kg that the hand holds 8 cm from its center. Drift is the
largest displacement in the hand during one stage of a task. CPU time is that of a trial with planning, as
a ratio to trials without `holding_impratio` and without the correction of the lag.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

import armcell
from armcell.cell import cell_names, run_task
from armcell.core import SE3, Box
from armcell.kinematics import kinematic_tree
from armcell.model import SuctionGripper
from armcell.scene import CollisionObject, Material, PlanningScene
from armcell.sim import SimWorld
from armcell.sim import friction as held_object_correction

LIMIT = 0.1  # [um/s] largest creep that passes
DRIFT_LIMIT = 0.5  # [mm]
TASKS = ("panda_pick", "six_axis_pick", "dual_ur10_sort", "dual_ur10_rod", "dual_ur10_screw")
LONG_TASKS = TASKS[2:]  # these run half as often
CLOSING = 1.5  # [s] for the fingers to close without gravity; then as long with gravity, before measuring


@dataclass(frozen=True)
class Load:
    """A box in the hand: size [m], mass [kg], and distance [m] of its center from the tcp."""

    name: str
    size: tuple[float, float, float]
    mass: float
    offset: float = 0.0


CUBE = (0.05, 0.05, 0.05)
PLATE = (0.2, 0.03)  # width and height of a load for suction cups, which are too far apart for a cube
LOADS = (
    Load("cube 0.1 kg", CUBE, 0.1),
    Load("cube 2 kg", CUBE, 2.0),
    Load("bar 0.5 kg, off center", (0.25, 0.04, 0.04), 0.5, 0.08),
)


def creep(cell: armcell.Cell, gripper: str, load: Load, seconds: float) -> tuple[float, float]:
    """Return the creep [um/s] and the rotation [urad/s] of a load in an idle hand.

    Raises:
        RuntimeError: the hand does not hold the load.
    """
    scene = PlanningScene.of(cell.model).with_positions(cell.scene().positions)
    hand = cell.model.grippers[gripper]
    T = kinematic_tree(cell.model).link_pose(scene.positions, hand.tcp_link)
    cups = isinstance(hand, SuctionGripper)
    size = (load.size[0], *PLATE) if cups else load.size
    place = T @ SE3.from_xyz(load.offset, 0.0, size[2] / 2 if cups else 0.0)  # jaws hold the middle
    item = CollisionObject.single(
        "load", Box(*size), place, movable=True, mass=load.mass, material=Material(friction=0.6)
    )
    world = SimWorld(scene.with_object(item), cell.physics)
    gravity, settle = world.mj_model.opt.gravity, round(CLOSING / world.timestep)
    weight = gravity.copy()
    gravity[:] = 0.0
    world.set_gripper_target(gripper, 0.0)
    world.step(settle)
    gravity[:] = weight
    world.step(settle)
    world.watch_slip("load", gripper)
    world.step(round(seconds / world.timestep))
    if world.gripper_state(gripper).held != "load":
        raise RuntimeError(f"{cell.name}: {gripper} lost {load.name}")
    meters, radians = world.slip(gripper)
    return meters / seconds * 1e6, radians / seconds * 1e6


def print_creep(seconds: float) -> bool:
    """Print the largest creep of each cell; return whether every value is within the limit."""
    fine = True
    print(f"creep in {seconds:g} s in an idle hand [um/s], rotation [urad/s]; largest of a cell's hands")
    for name in cell_names():
        cell = armcell.load(name)
        found = [[creep(cell, gripper, load, seconds) for gripper in cell.model.grippers] for load in LOADS]
        worst = [max(rows) for rows in found]
        fine = fine and max(rows[0] for rows in worst) <= LIMIT
        texts = (f"{load.name} {c:.4f}, {t:.3f}" for load, (c, t) in zip(LOADS, worst, strict=True))
        print(f"  {name:16} " + "; ".join(texts), flush=True)
    return fine


@contextmanager
def _plain_friction(cell: armcell.Cell) -> Iterator[None]:
    """Run a cell with MuJoCo's plain friction: one `impratio`, and no correction of the lag."""
    physics, lag = cell.physics, held_object_correction.lag
    cell.physics = replace(physics, holding_impratio=physics.impratio)
    held_object_correction.lag = lambda settings: 0.0
    try:
        yield
    finally:
        cell.physics, held_object_correction.lag = physics, lag


def _trial(cell: armcell.Cell, seed: int) -> tuple[dict, float]:
    began = time.process_time()
    with cell.connect("sim", seed=seed) as live:
        result = run_task(cell, live, seed, "sim")
    return result, time.process_time() - began


def print_drift(runs: int) -> bool:
    """Print drift, successes, contacts and CPU time of the tasks; return whether the drift passes."""
    fine = True
    print(
        "tasks: successes, unwanted contacts, drift and placement error (mean, largest), CPU time per trial"
    )
    for name in TASKS:
        cell, rows = armcell.load(name), {True: [], False: []}
        _trial(cell, 0)  # compiles and fills the caches
        for seed in range(runs if name not in LONG_TASKS else max(1, runs // 2)):
            for plain in (seed % 2 == 0, seed % 2 == 1):
                if plain:
                    with _plain_friction(cell):
                        rows[True].append(_trial(cell, seed))
                else:
                    rows[False].append(_trial(cell, seed))
        for plain, trials in rows.items():
            drift = [(r["max_stage_slip_m"] or 0.0) * 1e3 for r, _ in trials]
            error = [(r["placement_error_m"] or 0.0) * 1e3 for r, _ in trials]
            fine = fine and (plain or max(drift) <= DRIFT_LIMIT)
            ratio = np.median([a[1] / b[1] for a, b in zip(trials, rows[True], strict=True)])
            print(
                f"  {name:16} {'plain friction' if plain else 'held':14}"
                f" {sum(r['success'] for r, _ in trials)} of {len(trials)},"
                f" contacts {sum(len(r['unwanted_contacts']) for r, _ in trials)},"
                f" drift {np.mean(drift):.3f}, {max(drift):.3f} mm,"
                f" placed {np.mean(error):.3f}, {max(error):.3f} mm,"
                f" CPU time {ratio:.2f}",
                flush=True,
            )
    return fine


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, help="time in the hand")
    parser.add_argument("--runs", type=int, default=10, help="trials of each task; 0 measures only the creep")
    given = parser.parse_args()
    still = print_creep(given.seconds)
    carried = print_drift(given.runs) if given.runs else True
    verdict = {True: "yes", False: "NO"}
    print(f"creep <= {LIMIT} um/s: {verdict[still]}; drift <= {DRIFT_LIMIT} mm: {verdict[carried]}")


if __name__ == "__main__":
    main()
