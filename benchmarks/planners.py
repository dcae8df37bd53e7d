"""Every planner of every pipeline on a handful of problems: CPU time, success over seeds, path length.

python -m benchmarks.planners --seeds 3 --seconds 2     # writes docs/benchmarks_planners.md
"""

from __future__ import annotations

import argparse
import platform
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from armcell.core import SE3, SO3, Box, Goal, JointGoal, JointState, PlanRequest, PoseGoal
from armcell.model import load_robot
from armcell.planning import pipelines, plan
from armcell.planning.planners.registry import PILZ
from armcell.scene import CollisionObject, PlanningScene

PAGE = Path(__file__).parent.parent / "docs" / "benchmarks_planners.md"
DOWN = SO3.from_rpy((np.pi, 0.0, 0.0))
FORWARD = SO3.from_rpy((0.0, np.pi / 2, 0.0))


@dataclass(frozen=True, eq=False)
class Case:
    """A problem: what is planned, in which scene."""

    name: str
    words: str
    scene: PlanningScene
    goal: Goal


def box(name: str, size: tuple[float, float, float], at: tuple[float, float, float]) -> CollisionObject:
    return CollisionObject.single(name, Box(*size), SE3.from_xyz(*at))


def cases() -> Iterator[Case]:
    panda = load_robot("panda")
    beside = JointState(
        ("panda_joint1", "panda_joint2", "panda_joint4", "panda_joint6"), [-0.46, 0.3, -2.2, 2.5]
    )
    table = box("table", (1.2, 1.6, 0.04), (0.4, 0.0, -0.021))
    over = PlanningScene.of(panda, objects=[box("wall", (0.3, 0.02, 0.35), (0.55, 0.0, 0.175)), table])
    yield Case(
        "easy",
        "Panda, over a low wall",
        over.with_state(beside),
        PoseGoal(SE3(DOWN, np.array([0.5, 0.25, 0.12]))),
    )

    shelf = [
        box("left", (0.3, 0.02, 0.7), (0.6, 0.3, 0.35)), box("right", (0.3, 0.02, 0.7), (0.6, -0.3, 0.35)),
        box("back", (0.02, 0.6, 0.7), (0.76, 0.0, 0.35)),
        *(box(f"board_{k}", (0.3, 0.6, 0.02), (0.6, 0.0, z)) for k, z in enumerate((0.02, 0.36, 0.7))),
    ]  # fmt: skip
    into = PlanningScene.of(panda, objects=shelf)
    yield Case(
        "shelf",
        "Panda, into the lower compartment of a shelf",
        into,
        PoseGoal(SE3(FORWARD, np.array([0.58, 0.1, 0.2]))),
    )

    slot = [
        box("above", (0.5, 1.6, 0.02), (0.62, 0.0, 0.62)), box("below", (0.5, 1.6, 0.02), (0.62, 0.0, 0.38)),
        box("post", (0.02, 0.3, 0.22), (0.5, 0.0, 0.5)),
    ]  # fmt: skip
    between = PlanningScene.of(panda, objects=slot)
    yield Case(
        "narrow",
        "Panda, into a slot 0.22 m high",
        between,
        PoseGoal(SE3(FORWARD, np.array([0.58, 0.35, 0.5]))),
    )

    ur10 = load_robot("ur10")
    wall = [box("wall", (0.6, 0.02, 0.9), (0.8, 0.0, 0.45)), box("table", (2, 2, 0.04), (0.5, 0, -0.021))]
    around = PlanningScene.of(ur10, objects=wall).with_state(
        JointState(("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"), [-0.8, -1.2, 1.2])
    )
    yield Case(
        "ur10",
        "UR10, to the other side of a wall",
        around,
        JointGoal(JointState(("shoulder_pan_joint",), [0.8])),
    )


@dataclass(frozen=True)
class Measured:
    """Of one planner on one problem: CPU seconds and lengths [rad] of the successes; how many tries."""

    cpu: tuple[float, ...]
    lengths: tuple[float, ...]
    tries: int
    failure: str = ""

    def cell(self) -> str:
        if not self.cpu:
            return f"0/{self.tries}"
        share = f"{len(self.cpu)}/{self.tries}"
        return f"{share}, {1000 * np.median(self.cpu):.3g} ms, {np.median(self.lengths):.2f} rad"


def measure(case: Case, pipeline: str, planner: str, seeds: int, seconds: float) -> Measured:
    cpu, lengths, failure = [], [], ""
    for seed in range(seeds):
        request = PlanRequest(
            "arm", (case.goal,), pipeline_id=pipeline, planner_id=planner, planning_time=seconds, seed=seed
        )
        began = time.process_time()
        result = plan(case.scene, request)
        spent = time.process_time() - began
        if result.ok and result.path is not None:
            if result.planner_id != planner:
                raise SystemExit(f"{case.name} is no problem: {result.planner_id} solves it")
            cpu.append(spent)
            lengths.append(result.path.length)
        else:
            failure = result.message
    return Measured(tuple(cpu), tuple(lengths), seeds, failure)


HEAD = """# Comparison of all planners

The tables describe four planning problems, and compare all planners of all pipelines on these problems.
Each entry of the second table contains the number of solved runs, the median CPU time of the solved runs (all
threads of the process) and the median path length of the solved runs. The CPU time covers planning from the
request to a proven and timed motion.
`make bench-planners` writes this page. Each planner plans each problem with {seeds} seeds and {seconds:g} s
of planning time per seed, on an {machine} machine.

Anytime planners continue to improve a path until a time limit. OMPL's AORRTC, BIT*, PRM*, RRT* and
similar planners stop after 1 s if they have a solution; the native AORRTC uses the whole planning time
of {seconds:g} s. The native PRM keeps its roadmap from run to run, so the runs with later seeds reuse
the roadmap of earlier runs. OMPL's planners call armcell's collision kernel from Python. armcell
shortens the paths of all planners.

"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=2.0)
    parser.add_argument("--out", type=Path, default=PAGE)
    asked = parser.parse_args()
    problems = list(cases())
    names = [
        (pipeline, planner) for pipeline, table in pipelines.items() if pipeline != PILZ for planner in table
    ]
    for case in problems:  # compiles and fits what is kept after the first use
        for planner in pipelines["native"]:
            measure(case, "native", planner, 1, 0.1)
    lines = ["| problem | description |", "|---|---|"]
    lines += [f"| {case.name} | {case.words} |" for case in problems]
    lines += [
        "",
        "| planner | " + " | ".join(c.name for c in problems) + " |",
        "|" + "---|" * (len(problems) + 1),
    ]
    for pipeline, planner in names:
        row = [measure(case, pipeline, planner, asked.seeds, asked.seconds) for case in problems]
        lines.append(f"| {pipeline} / {planner} | " + " | ".join(m.cell() for m in row) + " |")
        print(lines[-1], *(m.failure for m in row if m.failure), flush=True)
    head = HEAD.format(seeds=asked.seeds, seconds=asked.seconds, machine=platform.machine())
    asked.out.write_text(head + "\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
