"""armcell: its native planner, or one of OMPL's through its kernel."""

from __future__ import annotations

from armcell.cli.bench_mbm import scene_of
from armcell.cli.bench_plans import planner
from armcell.collision.kernel.checker import KernelChecker
from armcell.model import load_robot
from armcell.planning import warm_up
from benchmarks.planning.peers.base import Result
from benchmarks.planning.problems import Problem, Robot


class Armcell:
    """Every path is proven free of contact; the proof's time is counted."""

    def __init__(self, name: str, planner_id: str):
        self.name, self._plan = name, planner(planner_id)

    def load(self, robot: Robot) -> None:
        warm_up()
        self.robot, self.model = robot, load_robot(robot.urdf)
        columns = self.model.columns(robot.joints)
        self.lower, self.upper = self.model.lower[columns], self.model.upper[columns]

    def set_problem(self, problem: Problem) -> None:
        scene = scene_of(self.model, self.robot.fixed, {"obstacles": problem.obstacles})
        self.checker, self.problem = KernelChecker(scene, self.robot.joints), problem

    def plan(self, seed: int, seconds: float) -> Result:
        p = self.problem
        a = self._plan(self.checker, p.start, p.goal[None], self.lower, self.upper, seconds)
        return Result(a.plan_s * 1e6, a.simplify_s * 1e6, a.certify_s * 1e6, a.raw, a.waypoints)
