"""Compile kernels and tests, and fit robot covers, before the tests run: `python -m tests.prepare`.

Several pytest workers, and the programs that tests start, would each compile the same kernels and test files.
With warm caches this takes 10 s; with empty ones it uses two cores for about a minute.
"""

from __future__ import annotations

import os
import subprocess
import sys

import armcell
from armcell.cell import run_task
from armcell.planning import warm_up
from armcell.planning.constraints.plan import warm_up_constraints
from armcell.planning.planners.aorrtc import warm_up_aorrtc
from armcell.planning.planners.prm import warm_up_roadmap

CELLS = {"panda_pick": "sim", "six_axis_pick": "sim", "dual_ur10_sort": "fake", "six_axis_camera": "sim"}
"""They use every robot of the library, physics, timing, grasps and perception."""


def run(name: str, mode: str) -> None:
    """One run of a cell with the seed 0."""
    cell = armcell.load(name)
    with cell.connect(mode, seed=0) as live:
        run_task(cell, live, 0, mode)


def main(part: str = "all") -> int:
    """Prepare everything, or the part that another process has been started for.

    Returns:
        Exit status: 0, or that of another process that failed.
    """
    if part == "constraints":
        warm_up_constraints()
        return 0
    collect = [sys.executable, "-m", "pytest", "--collect-only", "-qq"]  # writes the bytecode of all tests
    tests = subprocess.Popen(collect, stdout=subprocess.DEVNULL)
    warm_up()  # both parts use these kernels
    other = subprocess.Popen([sys.executable, "-m", "tests.prepare", "constraints"], env=os.environ)
    warm_up_roadmap()
    warm_up_aorrtc()
    for name, mode in CELLS.items():
        run(name, mode)
    return other.wait() or tests.wait()


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
