"""Pick and place a cube and a can with each robot that has a gripper, in physics with friction grips.

    python -m benchmarks.robot_picks panda ur10_gripper my_cell/ --seeds 20 --rows rows.md

A robot is a library name or a folder that `armcell setup` has written. The cell is the one of `armcell new`,
with the cube or with a can; each seed moves the object by up to 20 mm and turns it by up to 45 degrees. A
trial succeeds if the task succeeds, places the object within the tolerance and has no unwanted contact and no
weld.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from armcell.cell import load, run_task
from armcell.cell.starter import starter_cells
from armcell.cli.check import findings
from armcell.core import InputError
from armcell.model import RobotModel, load_robot, robot_names
from armcell.model.untrusted_files import read_yaml

ROBOTS = (
    "panda", "ur10_gripper", "z1", "scara", "palletizer", "mobile_ur10", "ur10_rail", "so100", "so101",
    "baxter", "pr2", "tiago_pro",
)  # fmt: skip
OBJECTS = ("cube", "can")
SHIFT = 0.02  # [m] to each side
TURN = 45.0  # [deg] to each side


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.robot_picks", description=__doc__,
        formatter_class=argparse.RawTextHelpFormatter,
    )  # fmt: skip
    parser.add_argument("robots", nargs="*", default=ROBOTS, metavar="ROBOT", help="names or folders")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--objects", nargs="+", choices=OBJECTS, default=OBJECTS)
    parser.add_argument("--rows", type=Path, help="file to which the table's rows are appended")
    given = parser.parse_args()
    print("| robot | gripper | cube | can | unwanted contacts |\n|---|---|---|---|---|", flush=True)
    good = True
    for robot in given.robots:
        model = load_robot(robot)
        if not model.grippers:
            raise InputError(f"{robot} has no gripper", hint="set it up with `armcell setup --gripper`")
        counts = {kind: _trials(model, robot, kind, given.seeds) for kind in given.objects}
        row = _row(model, counts, given.seeds)
        print(row, flush=True)
        if given.rows:
            with given.rows.open("a", encoding="utf-8") as file:
                file.write(row + "\n")
        good &= all(n["success"] >= 0.95 * given.seeds and not n["contacts"] for n in counts.values())
    return 0 if good else 1


def _row(model: RobotModel, counts: dict[str, Counter[str]], seeds: int) -> str:
    gripper = next(iter(model.grippers.values()))  # the one with which the starter cell picks
    cells = [f"{counts[kind]['success']}/{seeds}" if kind in counts else "" for kind in OBJECTS]
    contacts = sum(n["contacts"] for n in counts.values())
    opening = f"{gripper.group}, {1000 * gripper.max_width:.0f} mm"
    return f"| {model.name} | {opening} | {cells[0]} | {cells[1]} | {contacts} |"


def _trials(model: RobotModel, robot: str, kind: str, seeds: int) -> Counter[str]:
    """Return the number of successful trials, of unwanted contacts, and of each cause of a failure."""
    counts: Counter[str] = Counter()
    with TemporaryDirectory() as made:
        folder = Path(made)
        if not _write_cell(model, robot, kind, folder):
            print(f"{model.name}: the arm reaches no {kind} on a table", file=sys.stderr)
            return counts
        cell = load(folder)
        for seed in range(seeds):
            with cell.connect("sim", seed=seed) as live:
                result = run_task(cell, live, seed, "sim")
            counts["contacts"] += len(result["unwanted_contacts"])
            if result["success"] and not result["welds"]:
                counts["success"] += 1
            else:
                print(f"{model.name}, {kind}, seed {seed}: {result['message'][:400]}", file=sys.stderr)
    return counts


def _write_cell(model: RobotModel, robot: str, kind: str, folder: Path) -> bool:
    """Write the first cell of `armcell new` whose nominal task succeeds with fake arms."""
    named = robot if robot in robot_names() else os.path.relpath(Path(robot).resolve(), folder)
    for text in starter_cells(model, named, {}):
        file = folder / "cell.yaml"
        file.write_text(text)
        data = read_yaml(file)
        if "cube" not in data["objects"]:
            continue
        file.write_text(json.dumps(_with(data, kind)))
        if _passes(folder):
            return True
    return False


def _with(data: dict[str, Any], kind: str) -> dict[str, Any]:
    """Replace the cube of a cell by an object of a kind, and draw its pose from the seed."""
    item = data["objects"]["cube"]
    if kind == "can":
        edge = item.pop("box")[0]
        item["cylinder"] = [round(edge / 2, 4), round(1.6 * edge, 4)]
        item["pose"][2] = round(item["pose"][2] + 0.3 * edge, 4)
    shift = [-SHIFT, SHIFT]
    data["randomize"] = {"cube": {"dx": shift, "dy": shift, "yaw_deg": [-TURN, TURN]}}
    return data


def _passes(folder: Path) -> bool:
    cell = load(folder)
    if not all(passed for passed, _, _ in findings(cell)):
        return False
    try:
        with cell.connect("fake", seed=None) as live:
            return bool(run_task(cell, live, None, "fake")["success"])
    except InputError:
        return False


if __name__ == "__main__":
    sys.exit(main())
