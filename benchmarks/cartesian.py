"""Random straight lines of a Panda and a UR10: how many are completed, and the CPU time of each.

Usage: python -m benchmarks.cartesian [SEED]
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from itertools import islice

import numpy as np

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import SE3, SO3, CartesianRequest, JointState
from armcell.kinematics import ik_solver
from armcell.model import load_robot
from armcell.planning import plan_cartesian
from armcell.scene import PlanningScene

LINES = 200


def lines(scene: PlanningScene, count: int, seed: int) -> list[CartesianRequest]:
    """From anywhere free, 5 to 40 cm far, turned by up to 0.6 rad; some free solution is at the end."""
    rng, ik = np.random.default_rng(seed), ik_solver(scene.model, "arm")
    checker = KernelChecker(scene, ik.joint_names)
    low, high = np.maximum(ik.lower, -np.pi), np.minimum(ik.upper, np.pi)
    found = []
    while len(found) < count:
        q = rng.uniform(low, high)
        if not checker.is_free(q):
            continue
        start = JointState(ik.joint_names, q)
        started = scene.with_state(start)
        T = started.frame_pose(ik.tip_link)
        way, axis = (v / np.linalg.norm(v) for v in (rng.normal(size=3), rng.normal(size=3)))
        turn = SO3.exp(axis * rng.uniform(0, 0.6))
        goal = SE3(turn @ T.rotation, T.translation + way * rng.uniform(0.05, 0.4))
        if any(checker.is_free(s) for s in islice(ik.solutions(goal, started.positions, rng), 8)):
            found.append(CartesianRequest("arm", (goal,), start=start))
    return found


def main(seed: int) -> None:
    for robot in ("panda", "ur10_gripper"):
        scene = PlanningScene.of(load_robot(robot))
        requests = lines(scene, LINES, seed)
        plan_cartesian(scene, requests[0])  # compiles
        causes: Counter[str] = Counter()
        spent = []
        for request in requests:
            began = time.process_time()
            result = plan_cartesian(scene, request)
            spent.append(1000 * (time.process_time() - began))
            causes[result.evidence.get("cause", "completed")] += 1
        print(
            f"{robot}: {causes['completed']} of {LINES} completed; CPU per line median "
            f"{np.median(spent):.1f} ms, 95 % {np.quantile(spent, 0.95):.1f} ms; {dict(causes)}"
        )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 7)
