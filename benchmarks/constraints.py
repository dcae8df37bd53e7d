"""Path constraints: arms that carry a glass through a bookshelf, by projection and by rejection sampling.

    python -m benchmarks.constraints [--runs 50] [--rejection 20]

Prints a Markdown table: milliseconds of CPU of one thread, the whole of plan() unless it says otherwise.
The search by rejection is the same RRT-Connect in the same run; it throws away samples and steps that leave
the tolerances instead of projecting them, and is given `--rejection` seconds.
"""

from __future__ import annotations

import argparse
import threading
import time
from dataclasses import dataclass

import numpy as np

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import (
    SE3,
    SO3,
    Box,
    Constraints,
    Cylinder,
    JointState,
    OrientationConstraint,
    PlanRequest,
    PoseGoal,
    PositionConstraint,
)
from armcell.kinematics import ik_solver
from armcell.model import load_robot
from armcell.planning import plan
from armcell.planning.constraints.manifold import ConstraintManifold
from armcell.planning.constraints.plan import ConstrainedPlanner
from armcell.planning.goals.joint_goals import find_joint_goals
from armcell.planning.planners.problem import sampling_bounds
from armcell.planning.planners.rrt_connect import planner_of
from armcell.planning.request import validate_request
from armcell.scene import CollisionObject, PlanningScene

AHEAD = SO3(np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]))  # tip's z ahead, its x down


REJECTIONS = 5  # seeds of the search by rejection


@dataclass(frozen=True)
class Cell:
    """A scene with the robot at its start, and what is asked of it."""

    name: str
    scene: PlanningScene
    goal: SE3
    constraints: Constraints

    def request(self, seed: int = 0, **options) -> PlanRequest:
        return PlanRequest(
            "arm", (PoseGoal(self.goal),), path_constraints=self.constraints, seed=seed, **options
        )


def upright(tolerance: float) -> Constraints:
    """The glass, whose axis is the tip's x, leans by at most about that much; free about its axis."""
    return Constraints(orientations=(OrientationConstraint(AHEAD, (np.pi, tolerance, tolerance)),))


def shelf(x: float, depth: float, width: float, boards: list[float], divider: bool) -> list[CollisionObject]:
    """Boards at heights [m], sides, a back, and perhaps a wall in the middle; its front is at x."""
    low, high = boards[0], boards[-1]
    middle = (low + high) / 2

    def part(name: str, size, at) -> CollisionObject:
        return CollisionObject.single(name, Box(*size), SE3.from_xyz(*at))

    parts = [part(f"board{i}", (depth, width, 0.02), (x + depth / 2, 0.0, z)) for i, z in enumerate(boards)]
    for name, y in (("left", width / 2), ("right", -width / 2), *([("divider", 0.0)] if divider else [])):
        parts.append(part(name, (depth, 0.02, high - low), (x + depth / 2, y, middle)))
    return [*parts, part("back", (0.02, width, high - low), (x + depth, 0.0, middle))]


def carrying(robot: str, objects: list[CollisionObject], at: SE3) -> PlanningScene:
    """A robot whose tip is at a pose, holding a glass."""
    model = load_robot(robot)
    scene = PlanningScene.of(model, objects=objects)
    tip = model.group("arm").tip_link
    ik = ik_solver(model, "arm")
    rng = np.random.default_rng(0)
    glass = CollisionObject.single(
        "glass", Cylinder(0.03, 0.12), at @ SE3.from_xyz_rpy((0.0, 0.0, 0.0), (0.0, np.pi / 2, 0.0))
    )
    for q in ik.nearest(at, scene.positions, rng, 64):
        held = scene.with_state(JointState(ik.joint_names, q)).with_object(glass)
        held = held.with_attached("glass", tip, [name for name in model.links if _holds(name)])
        checker = KernelChecker(held, ik.joint_names)
        if checker.is_free(q):
            return held
    raise RuntimeError(f"{robot} cannot be at {at}")


def _holds(link: str) -> bool:
    return any(word in link for word in ("finger", "hand", "gripper", "jaw", "palm"))


def cells() -> list[Cell]:
    panda_shelf = shelf(0.42, 0.3, 0.9, [0.15, 0.5, 0.85], divider=False)
    panda_divided = shelf(0.42, 0.3, 0.9, [0.2, 0.65], divider=True)
    ur_shelf = shelf(0.65, 0.35, 1.2, [0.2, 0.65, 1.1], divider=False)
    ur_divided = shelf(0.65, 0.35, 1.2, [0.3, 0.8], divider=True)

    def at(x: float, y: float, z: float) -> SE3:
        return SE3(AHEAD, np.array([x, y, z]))

    line = PositionConstraint(((Box(0.02, 2.0, 0.02), SE3.from_xyz(0.5, 0.0, 0.5)),))
    level = PositionConstraint(((Box(2.0, 2.0, 0.004), SE3.from_xyz(0.5, 0.0, 0.4)),))
    wall = [CollisionObject.single("post", Box(0.06, 0.06, 0.45), SE3.from_xyz(0.55, 0.0, 0.225))]
    return [
        Cell("Panda, glass, lower to upper board, 0.15 rad",
             carrying("panda", panda_shelf, at(0.52, -0.2, 0.3)), at(0.52, 0.2, 0.66), upright(0.15)),
        Cell("Panda, glass, around the divider, 0.1 rad",
             carrying("panda", panda_divided, at(0.54, -0.2, 0.4)), at(0.54, 0.2, 0.4), upright(0.1)),
        Cell("UR10, glass, lower to upper board, 0.15 rad",
             carrying("ur10_gripper", ur_shelf, at(0.78, -0.3, 0.4)), at(0.78, 0.3, 0.85), upright(0.15)),
        Cell("UR10, glass, around the divider, 0.1 rad",
             carrying("ur10_gripper", ur_divided, at(0.8, -0.3, 0.55)), at(0.8, 0.3, 0.55), upright(0.1)),
        Cell("Panda, tip within 10 mm of a line, 0.1 rad",
             carrying("panda", [], at(0.5, -0.3, 0.5)), at(0.5, 0.3, 0.5),
             Constraints(positions=(line,), orientations=upright(0.1).orientations)),
        Cell("Panda, tip within 2 mm of a plane, past a post",
             carrying("panda", wall, at(0.55, -0.25, 0.4)), at(0.55, 0.25, 0.4),
             Constraints(positions=(level,))),
    ]  # fmt: skip


def by_rejection(cell: Cell, seconds: float, seed: int = 0) -> tuple[float, bool, int]:
    """CPU seconds of the search by rejection, whether it found a path, and its samples."""
    request, scene = cell.request(seed), cell.scene
    checker = KernelChecker(scene, scene.model.group("arm").joint_names)
    start = scene.positions[checker.columns]
    goals, _ = find_joint_goals(validate_request(scene, request), checker, np.random.default_rng(seed))
    manifold = ConstraintManifold(scene, "arm", cell.constraints)
    goals = [q for q in goals if not manifold.violations(q)]
    lower, upper = sampling_bounds(scene.model, checker.joint_names, start, goals)
    planner = ConstrainedPlanner(planner_of(checker), manifold, rejection=True)
    stop = np.zeros(1, np.int64)
    timer = threading.Timer(seconds, lambda: stop.__setitem__(0, 1))
    timer.start()
    began = time.thread_time()
    count, iterations, _ = planner.search(start, np.vstack(goals), lower, upper, seed, stop, 1 / 32)
    spent = time.thread_time() - began
    timer.cancel()
    return spent, count > 0, iterations


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--runs", type=int, default=50, help="seeds per cell")
    parser.add_argument("--rejection", type=float, default=20.0, help="[s] for rejection, 0: leave it out")
    given = parser.parse_args()
    print("| cell | solved | plan() median / p95 ms | search alone ms | motion s | rejection, search alone |")
    print("|---|---|---|---|---|---|")
    for cell in cells():
        plan(cell.scene, cell.request())
        times, searches, durations, solved = [], [], [], 0
        for seed in range(given.runs):
            began = time.process_time()
            result = plan(cell.scene, cell.request(seed))
            times.append(time.process_time() - began)
            if result.ok and result.trajectory is not None:
                solved += 1
                durations.append(result.trajectory.duration)
                searches.append(result.evidence.get("plan_us", 0.0) / 1e6)
        against = "not run"
        if given.rejection > 0:
            tries = [by_rejection(cell, given.rejection, seed) for seed in range(REJECTIONS)]
            found, spent = sum(ok for _, ok, _ in tries), float(np.median([s for s, _, _ in tries]))
            ratio = spent / max(float(np.median(searches)), 1e-6)
            sign = ">" if found <= REJECTIONS / 2 else ""
            against = f"{found}/{REJECTIONS} found, median {sign}{spent:.2f} s: {sign}{ratio:.0f} x"
        print(
            f"| {cell.name} | {solved}/{given.runs} | {np.median(times) * 1e3:.1f} / "
            f"{np.percentile(times, 95) * 1e3:.1f} | {np.median(searches) * 1e3:.2f} | "
            f"{np.median(durations):.2f} | {against} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
