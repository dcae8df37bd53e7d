"""What a planner for two UR10 takes of memory, and of time, with a cloud of 200,000 points around them.

Run as a module it measures this process, so that nothing else is in the figure; `measure` does so.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.planning.commands import Missing

POINTS = 200_000
RADIUS = 0.004  # [m]
TASKS = 40  # of the dual bench, at most, that are tried: with the cloud some postures touch


def measure() -> dict[str, Any]:
    """A fresh process's answer (see `main`).

    Raises:
        Missing: it ended with an error.
    """
    call = [sys.executable, "-m", "benchmarks.planning.memory"]
    done = subprocess.run(call, capture_output=True, text=True, cwd=Path(__file__).parents[2])
    if done.returncode:
        raise Missing((done.stderr.strip().splitlines() or ["no message"])[-1])
    return json.loads(done.stdout)


def main() -> dict[str, Any]:
    """Growth of the resident set from before the checker until after planning, at its highest [MB], beside
    the CPU time of the cloud's tree and of planning, with the cloud and with the solids that it was seen of.

    The scene is that of `armcell bench dual`, its world seen as points. What is measured holds the kernel's
    arrays, the planner's, the exact checker's and the compiled code.
    """
    from armcell.cli import bench_dual, bench_plans
    from armcell.collision.kernel.checker import KernelChecker
    from armcell.collision.kernel.cloud_arrays import cloud_of
    from armcell.core import PlanRequest, PointCloud
    from armcell.planning import warm_up
    from armcell.scene import CollisionObject

    warm_up()  # compiled and covers fitted, in case this is the first time
    tasks = list(bench_dual._tasks(TASKS, 0, PlanRequest.arm_clearance))
    scene, points = tasks[0].scene, world_points(tasks[0].scene, POINTS)
    for name in tuple(scene.objects):
        scene = scene.without_object(name)
    before = _status("VmRSS")
    scene = scene.with_object(CollisionObject.single("cloud", PointCloud(points, RADIUS)))
    began = time.process_time()
    cloud_of(scene.objects["cloud"].shapes[0][0])
    built = time.process_time() - began
    plan = bench_plans.planner("native")

    def planned(checker: KernelChecker) -> list[float]:
        """CPU time [ms] of every task that has a free start and goal; infinite where it is not solved."""
        times = []
        for task in tasks:
            if bench_plans.endpoint_collisions(checker, task.start, task.goals):
                continue
            began = time.process_time()
            answer = plan(checker, task.start, task.goals, task.lower, task.upper, 5.0)
            took = (time.process_time() - began) * 1e3
            times.append(took if answer.waypoints is not None else np.inf)
        return times

    times = planned(KernelChecker(scene, tasks[0].joint_names))
    result = {"points": len(points), "mb": _status("VmHWM") - before, "process_mb": _status("VmHWM")}
    solids = planned(KernelChecker(tasks[0].scene, tasks[0].joint_names))
    return result | {
        "build_ms": built * 1e3,
        "tasks": len(times),
        "solved": int(np.isfinite(times).sum()),
        "plan_ms_median": float(np.median(times)),
        "solids_plan_ms_median": float(np.median(solids)),
    }


def world_points(scene: Any, count: int, seed: int = 0) -> np.ndarray:
    """Points (count, 3) spread over the surfaces of a scene's boxes."""
    rng, every, areas = np.random.default_rng(seed), [], []
    for item in scene.objects.values():
        for shape, T in item.shapes:
            every.append((shape, item.T_world_object @ T))
            areas.append(2 * (shape.x * shape.y + shape.y * shape.z + shape.z * shape.x))
    parts = []
    for (shape, T), k in zip(every, rng.multinomial(count, np.array(areas) / sum(areas)), strict=True):
        size = 2 * shape.half_extents
        points = rng.uniform(-0.5, 0.5, (k, 3)) * size
        side = np.prod(size) / size  # area of the faces across each axis
        axis = rng.choice(3, k, p=side / side.sum())
        points[np.arange(k), axis] = rng.choice([-0.5, 0.5], k) * size[axis]
        parts.append(T.apply(points))
    return np.vstack(parts)


def _status(key: str) -> float:
    """A line of /proc/self/status [MB]."""
    text = Path(f"/proc/{os.getpid()}/status").read_text()
    return int(text.split(f"{key}:")[1].split()[0]) / 1024


if __name__ == "__main__":
    json.dump(main(), sys.stdout)
