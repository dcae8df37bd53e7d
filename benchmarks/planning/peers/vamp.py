"""VAMP (C++ with SIMD, robots as spheres): RRT-Connect and `simplify`, as its `evaluate_mbm.py` uses them."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import vamp
from vamp import configure_robot_and_planner_with_kwargs, problem_dict_to_vamp

from benchmarks.planning.peers.base import Result, Stopwatch, UnsupportedRobot
from benchmarks.planning.problems import Problem, Robot


class Vamp:
    """Plans for the robots that are compiled into VAMP, with the settings and the sampler of its own script.

    VAMP ends a search after 1,000,000 iterations, its script's limit; it takes no time limit. The buffers for
    that many samples take 0.1 ms. They are not counted, because VAMP's own clock, which its script reports,
    leaves them out. This clock shows wall time, so the thread's CPU time counts if it is shorter.
    """

    name = "VAMP"

    def load(self, robot: Robot) -> None:
        theirs = list(getattr(vamp, robot.name).joint_names()) if robot.name in vamp.robots else []
        if sorted(theirs) != sorted(robot.joints):
            raise UnsupportedRobot(f"it was compiled for {', '.join(vamp.robots)}, not for this {robot.name}")
        self.module, self._rrtc, self._settings, self._simplify = configure_robot_and_planner_with_kwargs(
            robot.name, "rrtc"
        )
        self._sampler = self.module.halton()
        self._to_vamp = [robot.joints.index(name) for name in theirs]
        self._from_vamp = [theirs.index(name) for name in robot.joints]

    def set_problem(self, problem: Problem) -> None:
        """Convert the obstacles as VAMP does for MotionBenchMaker: cylinders become capsules that are longer
        by a radius at both ends, but boxes in the family `box`.
        """
        self._ends = [q[self._to_vamp].astype(np.float32) for q in (problem.start, problem.goal)]
        self._environment = problem_dict_to_vamp(_problem_dict(problem))
        # From an end that touches its spheres, it would search until its last iteration.
        self._possible = all(self.module.validate(q, self._environment) for q in self._ends)

    def plan(self, seed: int, seconds: float) -> Result:
        if not self._possible:
            return Result(0.0)
        self._sampler.reset()
        self._sampler.skip(seed)
        watch = Stopwatch()
        found = self._rrtc(*self._ends, self._environment, self._settings, self._sampler)
        plan_us = _time_us(watch, found)
        if not found.solved:
            return Result(plan_us)
        watch()
        shorter = self.module.simplify(found.path, self._environment, self._simplify, self._sampler)
        simplify_us = _time_us(watch, shorter)
        return Result(plan_us, simplify_us, 0.0, self._waypoints(found.path), self._waypoints(shorter.path))

    def _waypoints(self, path) -> np.ndarray:
        return np.array(path.numpy(), float)[:, self._from_vamp]


def _time_us(watch: Stopwatch, result) -> float:
    return min(watch(), result.nanoseconds * 1e-3)


def _problem_dict(problem: Problem) -> dict:
    """The problem as VAMP's files of MotionBenchMaker describe it."""
    objects: dict[str, list[dict]] = {"sphere": [], "cylinder": [], "box": []}
    for o in problem.obstacles:
        rotation = pin.XYZQUATToSE3(np.array([*o["position"], *o["quat_xyzw"]])).rotation
        entry = {
            "name": o["name"],
            "position": o["position"],
            "orientation_euler_xyz": pin.rpy.matrixToRpy(rotation).tolist(),
        }
        if o["type"] == "box":
            entry["half_extents"] = [size / 2 for size in o["size"]]
        else:
            entry |= {"radius": o["radius"], "length": o["length"]}
        objects[o["type"]].append(entry)
    return {"problem": problem.family, **objects}
