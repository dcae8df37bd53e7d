"""Bins of mixed objects that one or two UR10 clear with nothing but the images of depth cameras.

    python -m benchmarks.bins --seeds 20 --counts 12 20 --arms 1 2
    python -m benchmarks.bins --meshes FOLDER         # other objects: all meshes of a folder, at true scale
    python -m benchmarks.bins --wall 0.12 --arms 1    # a bin with other walls

Each bin holds objects of the grasp benchmark (`grasp_objects`) that are graspable on their three most
stable sides, drawn at random and dropped in physics. The cells are `bin_clearing` (one arm) and
`dual_bin_clearing` (two arms) with these objects instead of their own. A bin is cleared if every object is in
a tray, by the true poses. Picks per hour count placed
objects per simulated time of the whole task, the last looks and failed picks included; planning costs no
simulated time.
"""

from __future__ import annotations

import argparse
import multiprocessing
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

import armcell
from armcell.cell import run_task
from armcell.core import SE3, SO3
from armcell.grasping import hand_of, stable_poses
from armcell.scene import Material, mesh_object
from benchmarks import grasp_objects
from benchmarks.grasp_objects import FRICTION, HALVES

BIN_TARGET = 0.95  # share of cleared bins
CELLS = {1: "bin_clearing", 2: "dual_bin_clearing"}  # by number of arms
RATE_TARGETS = {1: 600, 2: 900}  # picks per hour, by number of arms
LONGEST = 0.18  # [m] longest side of an object, less than half of the bin's
NARROW = 0.07  # [m] limit of the two shorter sides
SIDES = 3
DENSITY = 600.0  # [kg/m^3]
SUFFIXES = (".stl", ".obj", ".ply")


@dataclass(frozen=True)
class Run:
    """Result of one bin: objects in the tray of all, simulated time [s], picks, and the text of a failure."""

    objects: int
    cleared: int
    time: float
    picks: int
    contacts: int
    message: str


def meshes_in(folder: Path) -> list[Path]:
    """Return the mesh files below a folder."""
    return sorted(p for p in folder.rglob("*") if p.suffix.lower() in SUFFIXES)


def meshes_of_set(half: str | None) -> list[Path]:
    """Return the meshes of the set, or of one half of it."""
    return [
        grasp_objects.folder(e.source) / grasp_objects.WHEELS[e.source][1] / e.file
        for e in grasp_objects.listed()
        if half in (None, e.half)
    ]


def fits(file: Path, cell: armcell.Cell) -> bool:
    """Return whether an object fits the bin and the gripper, and is graspable on its most stable sides by the
    written rule of `grasp_objects`.
    """
    item = mesh_object(file.stem, file, density=DENSITY, material=Material(FRICTION))
    low, high = item.bounds()
    sides = np.sort(high - low)
    if sides[2] > LONGEST or sides[1] > NARROW:
        return False
    gripper = next(iter(cell.model.grippers.values()))
    pad = hand_of(cell.model, gripper).pad
    sides_down = [
        SE3(SO3.between(pose.up, (0.0, 0.0, 1.0)), np.zeros(3)) for pose in stable_poses(item)[:SIDES]
    ]
    return all(not grasp_objects.graspable(item.at(T), cell.model, gripper, pad) for T in sides_down)


def cell_with(files: Sequence[Path], folder: Path, arms: int = 1, wall: float | None = None) -> armcell.Cell:
    """Write the cell for this number of arms with an object for each of the given meshes, and load it.

    Args:
        wall: [m] height of the bin's walls; None: the cell's own.
    """
    source = Path(armcell.load(CELLS[arms]).file)
    spec = yaml.safe_load(source.read_text())
    own = spec["drop"]["objects"]
    poses = [spec["objects"].pop(name)["pose"] for name in own]
    if wall is not None:
        spec["objects"]["bin"]["sizes"]["height"] = wall
    names = []
    for i, (file, pose) in enumerate(zip(files, poses)):
        names.append(f"{file.stem}_{i}")
        spec["objects"][names[-1]] = {
            "mesh": str(file), "pose": pose, "movable": True, "density": DENSITY, "friction": FRICTION,
        }  # fmt: skip
    spec["drop"]["objects"] = spec["perception"]["objects"] = names
    (folder / "task.py").write_text((source.parent / "task.py").read_text())
    target = folder / "cell.yaml"
    target.write_text(yaml.safe_dump(spec, sort_keys=False))
    return armcell.load(str(target))


def run(cell: armcell.Cell, seed: int) -> Run:
    """Drop the objects of a cell with a seed, clear the bin, and return what is in the tray."""
    with cell.connect("sim", seed=seed) as live:
        result = run_task(cell, live, seed, "sim")
    evidence = result["measures"]
    return Run(
        evidence["things"], evidence["cleared"], result["task_time_s"], evidence["picks"],
        len(result["unwanted_contacts"]), "" if result["success"] else result["message"],
    )  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Clear the bins and print the table; 1 if a target is missed."""
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--seeds", type=int, default=20, help="bins of each size")
    ask.add_argument("--first", type=int, default=0, help="first seed")
    ask.add_argument("--counts", type=int, nargs="+", default=[12, 20], help="objects per bin, at most 20")
    ask.add_argument("--half", choices=HALVES, help="only objects of this half of the set")
    ask.add_argument("--meshes", type=Path, help="folder of other meshes, at true scale")
    ask.add_argument("--arms", type=int, nargs="+", choices=CELLS, default=[*CELLS], help="number of arms")
    ask.add_argument("--wall", type=float, help="[m] height of the bin's walls; default: the cell's")
    ask.add_argument("--workers", type=int, default=2)
    ask.add_argument("--keep", type=Path, help="folder for the cells of bins that were not cleared")
    a = ask.parse_args(arguments)
    files = meshes_in(a.meshes) if a.meshes else meshes_of_set(a.half)
    cell = armcell.load(CELLS[1])
    files = [file for file in files if fits(file, cell)]
    print(f"{len(files)} kinds of objects: {', '.join(file.stem for file in files)}")
    missed = [measured(a, files, arms, count) for arms in a.arms for count in a.counts]
    return int(any(missed))


def one_bin(
    files: Sequence[Path], arms: int, count: int, seed: int, keep: Path | None, wall: float | None
) -> Run:
    """Draw the objects of a bin, clear it, and print a line."""
    rng = np.random.default_rng((seed, count))
    chosen = [files[i] for i in rng.choice(len(files), count, replace=len(files) < count)]
    with tempfile.TemporaryDirectory() as scratch:
        folder = keep / f"bin_{arms}_{count}_{seed}" if keep else Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        cell, began = cell_with(chosen, folder, arms, wall), time.process_time()
        found = run(cell, seed)
    print(
        f"{arms} arms, {count} objects, seed {seed}: {found.cleared} cleared in {found.time:.0f} s, "
        f"{found.picks} picks, {found.contacts} unwanted contacts, "
        f"{time.process_time() - began:.0f} CPU-s {found.message}",
        flush=True,
    )
    return found


def measured(a: argparse.Namespace, files: Sequence[Path], arms: int, count: int) -> bool:
    """Clear the bins with this number of arms and of objects, and print the table; True if a target is
    missed.
    """
    seeds = range(a.first, a.first + a.seeds)
    with ProcessPoolExecutor(a.workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        jobs = [pool.submit(one_bin, files, arms, count, seed, a.keep, a.wall) for seed in seeds]
        runs = [job.result() for job in jobs]
    whole = sum(r.cleared == r.objects for r in runs)
    rate = 3600 * sum(r.cleared for r in runs) / sum(r.time for r in runs)
    contacts = Counter(r.contacts > 0 for r in runs)[True]
    print(
        f"\n{arms} arms, {count} objects: {whole} of {len(runs)} bins cleared (target {BIN_TARGET:.0%}), "
        f"{sum(r.cleared for r in runs)} of {sum(r.objects for r in runs)} objects; "
        f"{rate:.0f} picks per hour (target {RATE_TARGETS[arms]}); {contacts} bins with unwanted contacts\n"
    )
    return whole < BIN_TARGET * len(runs) or rate < RATE_TARGETS[arms] or contacts > 0


if __name__ == "__main__":
    raise SystemExit(main())
