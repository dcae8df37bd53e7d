"""Where pinocchio says that the tip is along a trajectory."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from tests.model.helpers import REFERENCES, PinRobot

from armcell.core import SE3, JointGoal, JointTrajectory, PlanRequest, PoseGoal
from armcell.kinematics import kinematic_tree
from armcell.scene import PlanningScene

NAMES = {"panda": "panda", "ur10": "ur10_gripper"}


@lru_cache
def pin_robot(name: str) -> PinRobot:
    model, reference = REFERENCES[name]()
    return PinRobot(reference, model)


class Watched:
    """A trajectory seen every `step` [s]: times (m,), joint positions and velocities (m, n), tip poses."""

    def __init__(self, scene: PlanningScene, trajectory: JointTrajectory, link: str, step: float = 0.002):
        robot = pin_robot(NAMES["panda" if "panda_hand" in scene.model.links else "ur10"])
        self.step = step
        self.times = np.arange(0.0, trajectory.duration, step)
        states = [trajectory.sample(t) for t in self.times]
        self.q = np.array([s[0] for s in states])
        self.v = np.array([s[1] for s in states])
        self.a = np.array([s[2] for s in states])
        tree, full = kinematic_tree(scene.model), scene.positions.copy()
        columns = scene.model.columns(trajectory.joint_names)
        self.poses = []
        for q in (*self.q, trajectory.positions[-1]):
            full[columns] = q
            robot.place(tree.full_positions(full))
            self.poses.append(SE3.from_matrix(robot.pose(link)))
        self.end = self.poses.pop()

    @property
    def points(self) -> np.ndarray:
        return np.array([p.translation for p in self.poses])

    @property
    def speed(self) -> np.ndarray:
        """[m/s] half-way between the times."""
        return np.linalg.norm(np.diff(self.points, axis=0), axis=1) / self.step

    @property
    def turning(self) -> np.ndarray:
        """[rad/s]"""
        pairs = zip(self.poses[:-1], self.poses[1:], strict=True)
        return np.array([a.distance_to(b)[1] for a, b in pairs]) / self.step


def tip_of(scene: PlanningScene) -> str:
    return scene.model.group("arm").tip_link


def tip(scene: PlanningScene) -> SE3:
    return scene.frame_pose(tip_of(scene))


def told(planner: str, goal, velocity: float = 0.3, acceleration: float = 0.2, **options) -> PlanRequest:
    """A request for PTP, LIN or CIRC; `goal` may be a pose."""
    goal = PoseGoal(goal) if isinstance(goal, SE3) else goal
    assert isinstance(goal, PoseGoal | JointGoal)
    return PlanRequest(
        "arm", (goal,), pipeline_id="pilz", planner_id=planner, velocity_scaling=velocity,
        acceleration_scaling=acceleration, **options,
    )  # fmt: skip
