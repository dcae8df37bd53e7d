"""roboplan (C++ on pinocchio and coal, from pip): RRT-Connect and its shortcutter."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path

import numpy as np
import pinocchio as pin
import trimesh
from roboplan import core
from roboplan.rrt import RRT, RRTOptions

from benchmarks.planning.peers.base import Result, Stopwatch
from benchmarks.planning.problems import Problem, Robot

GROUP = "benchmark"
CHECK_STEP = 0.05  # [rad] along an edge, roboplan's default


class Roboplan:
    name = "roboplan"

    def load(self, robot: Robot) -> None:
        self.robot = robot
        with tempfile.TemporaryDirectory() as folder:
            text = _with_stl(robot.urdf, Path(folder))
            packages = [robot.urdf.parent, folder]
            self.scene = core.Scene(robot.name, core.loadUrdfSceneDescriptionFromXml(text, packages))
        self.scene.importSrdf(robot.srdf.read_text())
        self.scene.addGroup(GROUP, list(robot.joints))
        q = self.scene.getCurrentJointPositions()
        for name, value in robot.fixed.items():
            if name in self.scene.getJointNames():
                q[self.scene.getJointPositionIndices([name])] = value
        self.scene.setJointPositions(q)
        self.obstacles: list[str] = []

    def set_problem(self, problem: Problem) -> None:
        for name in self.obstacles:
            self.scene.removeGeometry(name)
        self.problem = problem
        self.obstacles = [f"obstacle_{i}" for i in range(len(problem.obstacles))]
        for name, o in zip(self.obstacles, problem.obstacles):
            pose = pin.XYZQUATToSE3(np.array([*o["position"], *o["quat_xyzw"]]))
            place = np.asfortranarray(pose.homogeneous), np.ones(4)
            if o["type"] == "box":
                self.scene.addBoxGeometry(name, "universe", core.Box(*o["size"]), *place)
            else:
                self.scene.addCylinderGeometry(
                    name, "universe", core.Cylinder(o["radius"], o["length"]), *place
                )
        # It counts contact between two obstacles as a collision; MBM's obstacles stand on each other.
        pairs = [(a, b) for i, a in enumerate(self.obstacles) for b in self.obstacles[:i]]
        self.scene.setCollisions(pairs, False)

    def plan(self, seed: int, seconds: float) -> Result:
        names = list(self.robot.joints)
        start = core.JointConfiguration(names, self.problem.start)
        goal = core.JointConfiguration(names, self.problem.goal)
        options = RRTOptions(
            group_name=GROUP,
            max_nodes=1_000_000,
            collision_check_step_size=CHECK_STEP,
            max_planning_time=seconds,
            rrt_connect=True,
        )
        planner = RRT(self.scene, options)
        planner.setRngSeed(seed)
        shortcuts = core.PathShortcuttingOptions(group_name=GROUP, max_step_size=CHECK_STEP, seed=seed)
        watch = Stopwatch()
        try:
            path = planner.plan(start, goal)
        except RuntimeError:  # how it says that it found none
            return Result(watch())
        plan_us = watch()
        shorter = core.PathShortcutter(self.scene, shortcuts).shortcut(path)
        return Result(plan_us, watch(), 0.0, np.array(path.positions), np.array(shorter.positions))


def _with_stl(urdf: Path, folder: Path) -> str:
    """The URDF's text with its OBJ meshes as STL in a folder: what reads them for roboplan is wrong about
    OBJ files of several materials (see `pinocchio_world`)."""
    text = urdf.read_text()
    for uri in sorted(set(re.findall(r'"([^"]+\.obj)"', text))):
        source = urdf.parent / uri.removeprefix("package://")
        if source.is_file():
            name = source.with_suffix(".stl").name
            trimesh.load(source, force="mesh").export(folder / name)
            text = text.replace(f'"{uri}"', f'"package://{name}"')
    return text
