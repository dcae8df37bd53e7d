"""Robots from their vendors' descriptions: one `armcell setup`, then motions in clutter, checked again.

python -m benchmarks.robots FOLDER                     # every robot of benchmarks/robots.yaml
python -m benchmarks.robots FOLDER --only UR5e --json ur5e.json

FOLDER holds the vendors' repositories, each in a folder of its own name. For each robot the benchmark runs
`armcell setup` once, without edits, places boxes around the arm, and plans to 100 random collision-free
states, alternately to their joint positions and to the pose of the tip, each from the end of the last motion.
It then samples every motion and checks it on the vendor's meshes with `ExactChecker` and with pinocchio and
coal directly, which share no code with the planner's kernel.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import yaml
from numpy.typing import NDArray

import armcell
from armcell.cell.starter import base_bottom
from armcell.collision import ExactChecker
from armcell.core import SE3, Box, Goal, JointGoal, JointState, JointTrajectory, PlanRequest, PoseGoal
from armcell.kinematics import kinematic_tree
from armcell.model import Group, RobotModel
from armcell.planning import plan
from armcell.scene import CollisionObject, PlanningScene
from benchmarks.planning.pinocchio_world import PinocchioWorld
from benchmarks.planning.problems import Problem, Robot

Array = NDArray[np.float64]

LIST = Path(__file__).with_suffix(".yaml")
REASON = 2  # exit status if the benchmark cannot run
GOALS = 100
BOXES = 12
EDGES = 0.05, 0.15  # of a box, in reaches
RINGS = 0.5, 1.0  # distance of a box's center from the shoulder, in reaches
FREE = 0.02  # clearance of the start state, in reaches
STEP = 0.01  # [rad or m] largest step of a joint between two checked states
CONTROL = 1000  # random states on which the checks are compared
SWEEP = 200  # positions of the first joint in which its link must be free of boxes
RANGE = np.pi  # [rad] goals of a joint with more than one turn are within this of zero


@dataclass(frozen=True, eq=False)
class SetUp:
    """Outcome of `armcell setup`: its folder, its status and what it took [s]."""

    folder: Path
    status: int
    wall: float
    cpu: float
    output: str


def set_up(arguments: list[str], sources: Path, folder: Path) -> SetUp:
    """Run `armcell setup` in a process of its own, in the folder of the vendors' repositories."""
    command = [sys.executable, "-m", "armcell", "setup", *arguments, "-o", str(folder)]
    before, t0 = os.times(), time.perf_counter()
    done = subprocess.run(command, cwd=sources, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    wall, after = time.perf_counter() - t0, os.times()
    cpu = after.children_user + after.children_system - before.children_user - before.children_system
    return SetUp(folder, done.returncode, wall, cpu, done.stdout)


def arm_of(model: RobotModel) -> Group:
    """The first of the arms with the most joints."""
    arms = [g for g in model.groups.values() if g.tip_link and g.joint_names]
    return max(arms, key=lambda g: len(g.joint_names))


def drawn(model: RobotModel, arm: Group, rng: np.random.Generator, count: int) -> Array:
    """Random states (count, dof): the arm's joints within limits and one turn, the others at rest."""
    columns = model.columns(arm.joint_names)
    low, high = np.maximum(model.lower, -RANGE)[columns], np.minimum(model.upper, RANGE)[columns]
    states = np.tile(start_of(model, arm), (count, 1))
    states[:, columns] = rng.uniform(low, high, (count, len(columns)))
    return states


def start_of(model: RobotModel, arm: Group) -> Array:
    states = model.named_states.get(arm.name, {})
    q = model.default_positions()
    named = states.get("ready") or states.get("home") or {}
    for name, value in named.items():
        q[model.columns([name])] = value
    return q


def clutter(model: RobotModel, arm: Group, seed: int = 0) -> PlanningScene:
    """The robot at its ready state, on a table if its base allows one, among boxes within its reach."""
    rng = np.random.default_rng(seed)
    tree, q, tip = kinematic_tree(model), start_of(model, arm), str(arm.tip_link)
    shoulder = tree.link_pose(q, model.joints[arm.joint_names[min(1, len(arm.joint_names) - 1)]].child)
    tips = np.array([tree.link_pose(s, tip).translation for s in drawn(model, arm, rng, 1000)])
    reach = float(np.linalg.norm(tips - shoulder.translation, axis=1).max())
    lowest = base_bottom(model)
    scene = PlanningScene.of(model, q)
    table = Box(4 * reach, 4 * reach, 0.04)
    with_table = scene.with_object(CollisionObject.single("table", table, SE3.from_xyz(0, 0, lowest - 0.022)))
    if ExactChecker(with_table).is_free(q):
        scene = with_table
    number = 0
    while number < BOXES:
        direction = rng.normal(size=3)
        center = shoulder.translation + direction / np.linalg.norm(direction) * rng.uniform(*RINGS) * reach
        size, rpy = rng.uniform(*EDGES, 3) * reach, rng.uniform(-np.pi, np.pi, 3)
        if center[2] < lowest:
            continue
        box = CollisionObject.single(f"box_{number}", Box(*size), SE3.from_xyz_rpy(center, rpy))
        larger = CollisionObject.single(
            "room", Box(*(size + 2 * FREE * reach)), SE3.from_xyz_rpy(center, rpy)
        )
        if _touches_robot(PlanningScene.of(model, q, [larger]), q) or _blocks(model, arm, box, q):
            continue
        scene, number = scene.with_object(box), number + 1
    return scene


def _blocks(model: RobotModel, arm: Group, box: CollisionObject, q: Array) -> bool:
    """Whether a box touches links that only the arm's first joint moves, such as the carriage of a lift: no
    motion to the other side of such a box exists.
    """
    tree, (first, *others) = kinematic_tree(model), model.columns(arm.joint_names)
    bare = {}
    for name, link in model.links.items():
        moving = {int(tree.column[j]) for j in tree.path_to(name)}
        bare[name] = link if first in moving and not moving & set(others) else replace(link, collisions=())
    only = replace(model, links=bare, disabled_collisions={})
    checker = ExactChecker(PlanningScene.of(only, q, [box]))
    states = np.tile(q, (SWEEP, 1))
    states[:, first] = np.linspace(max(model.lower[first], -RANGE), min(model.upper[first], RANGE), SWEEP)
    return any(box.name in pair for state in states for pair in checker.touching(state))


def _touches_robot(scene: PlanningScene, q: Array) -> bool:
    return any("room" in pair for pair in ExactChecker(scene).touching(q))


class Reference(PinocchioWorld):
    """The written URDF in pinocchio and the scene's boxes in coal.

    `q` (dof,) are the planned joints; joints that mimic one of them follow, and continuous joints are points
    on the circle, as pinocchio has them.
    """

    def __init__(self, folder: Path, scene: PlanningScene, arm: Group):
        (urdf,) = folder.glob("config/*.urdf")
        self.tree, self.names = kinematic_tree(scene.model), arm.joint_names
        self.columns_of_arm = scene.model.columns(arm.joint_names)
        self.rest = np.array(scene.positions)
        moved = set(arm.joint_names)
        followers = [n for n, j in scene.model.joints.items() if j.mimic and j.mimic.joint in moved]
        super().__init__(Robot(urdf.stem, urdf, (*arm.joint_names, *followers), {}))
        boxes = [_obstacle(item) for item in scene.objects.values()]
        self.set_problem(Problem("", 0, np.zeros(0), np.zeros(0), boxes))

    def touches(self, q: Array) -> bool:
        self._place(q)
        return pin.computeCollisions(self.model, self.data, self._manager, self.q, True)

    def contact(self, q: Array) -> str:
        self._place(q)
        pin.computeCollisions(self.model, self.data, self.geometry, self.geometry_data, self.q, False)
        for pair, result in zip(
            self.geometry.collisionPairs, self.geometry_data.collisionResults, strict=True
        ):
            if result.isCollision():
                return " and ".join(self.geometry.geometryObjects[i].name for i in (pair.first, pair.second))
        return ""

    def _place(self, q: Array) -> None:
        self.rest[self.columns_of_arm] = q
        for name, value in self.tree.full_positions(self.rest).items():
            if not self.model.existJointName(name):
                continue
            joint = self.model.joints[self.model.getJointId(name)]
            if joint.nq == 2:
                self.q[joint.idx_q : joint.idx_q + 2] = np.cos(value), np.sin(value)
            else:
                self.q[joint.idx_q] = value


def _obstacle(item: CollisionObject) -> dict[str, Any]:
    """A box of the scene in the form of MotionBenchMaker's files."""
    ((shape, T_object_shape),) = item.shapes
    assert isinstance(shape, Box)
    T = item.T_world_object @ T_object_shape
    size = [shape.x, shape.y, shape.z]
    return {"type": "box", "size": size, "position": T.translation, "quat_xyzw": T.rotation.quat_xyzw}


def control(exact: ExactChecker, reference: Reference, states: Array) -> dict[str, int]:
    """How many random states (n, dof) each check finds in collision: a check that finds none proves nothing.

    The checks may differ in states in which one body is entirely inside another, as only `ExactChecker` looks
    inside.
    """
    exact_hits = np.array([not exact.is_free(q) for q in states])
    coal_hits = np.array([reference.touches(q) for q in states])
    return {
        "states": len(states),
        "exact": int(exact_hits.sum()),
        "coal": int(coal_hits.sum()),
        "only_exact": int((exact_hits & ~coal_hits).sum()),
        "only_coal": int((coal_hits & ~exact_hits).sum()),
    }


def samples(trajectory: JointTrajectory) -> Array:
    """States (n, dof) of a motion in which no joint moves more than STEP from one to the next."""
    count = max(2, len(trajectory.times))
    while True:
        q = trajectory.samples(np.linspace(0.0, trajectory.duration, count))[0]
        if np.abs(np.diff(q, axis=0)).max(initial=0.0) <= STEP:
            return q
        count *= 2


def measure(folder: Path, goals: int = GOALS) -> dict[str, Any]:
    """Plan to random goals in clutter and check every motion again."""
    model = armcell.load_robot(folder)
    arm = arm_of(model)
    scene, rng = clutter(model, arm), np.random.default_rng(1)
    columns, tree = model.columns(arm.joint_names), kinematic_tree(model)
    exact = ExactChecker(scene, arm.joint_names)
    free = [q for q in drawn(model, arm, rng, 200 * goals) if exact.is_free(q[columns])][:goals]
    found: dict[str, Any] = {"arm": arm.name, "joints": len(arm.joint_names), "goals": len(free)}
    motions: list[JointTrajectory] = []
    here, spent, failures = scene, [], []
    for i, q in enumerate([*free[:2], *free]):  # the first two compile and pack
        goal: Goal = JointGoal(JointState(arm.joint_names, q[columns]))
        if i % 2:
            goal = PoseGoal(tree.link_pose(q, str(arm.tip_link)))
        t0 = time.process_time()
        result = plan(here, PlanRequest(arm.name, (goal,), seed=i))
        if i < 2:
            continue
        spent.append(1000 * (time.process_time() - t0))
        if not result.ok or result.trajectory is None:
            failures.append(f"{type(goal).__name__} {i - 2}: {result.code.name}: {result.message}")
            continue
        motions.append(result.trajectory)
        end = JointState(result.trajectory.joint_names, result.trajectory.positions[-1])
        here = here.with_state(end)
    found |= {"solved": len(motions), "p50_ms": float(np.median(spent)), "failures": failures}
    reference = Reference(folder, scene, arm)
    found["control"] = control(exact, reference, drawn(model, arm, rng, CONTROL)[:, columns])
    contacts: dict[str, list[str]] = {"exact": [], "coal": []}
    states = 0
    for number, motion in enumerate(motions):
        q = samples(motion)
        states += len(q)
        bad = next((row for row in q if not exact.is_free(row)), None)
        if bad is not None:
            contacts["exact"].append(f"{number}: {exact.contacts(bad)[:1]}")
        bad = next((row for row in q if reference.touches(row)), None)
        if bad is not None:
            contacts["coal"].append(f"{number}: {reference.contact(bad)}")
    return found | {"states": states, "contacts": contacts}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("sources", type=Path, nargs="?", help="folder of the vendors' repositories")
    parser.add_argument("--list", type=Path, default=LIST, help="robots and arguments of armcell setup")
    parser.add_argument("--only", action="append", help="a robot's name; may be repeated")
    parser.add_argument("--goals", type=int, default=GOALS)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    if given.sources is None:
        print("robots: name the folder that holds the vendors' repositories")
        sys.exit(REASON)
    rows = []
    for entry in yaml.safe_load(given.list.read_text()):
        if given.only and entry["robot"] not in given.only:
            continue
        with tempfile.TemporaryDirectory() as place:
            done = set_up(entry["setup"], given.sources.resolve(), Path(place) / "cell")
            row = entry | {
                "status": done.status,
                "cpu_s": done.cpu,
                "wall_s": done.wall,
                "output": done.output,
            }
            if done.status == 0:
                row |= measure(done.folder, given.goals)
        rows.append(row)
        print(markdown(row), flush=True)
        if given.json:
            given.json.write_text(json.dumps(rows, indent=1) + "\n")


def markdown(row: dict[str, Any]) -> str:
    """A row of the table in docs/robots.md."""
    name = f"| {row['robot']} | {row['vendor']} | {row['source']} |"
    if row["status"]:
        return f"{name} | {row['cpu_s']:.0f} | {row['output'].strip().splitlines()[-1]} |"
    bad = max(len(v) for v in row["contacts"].values())
    solved = f"{row['solved']} of {row['goals']}"
    return f"{name} {row['joints']} | {row['cpu_s']:.0f} | {solved} | {row['p50_ms']:.1f} | {bad} |"


if __name__ == "__main__":
    main()
