"""From a pose goal to a certified, timed trajectory, through the Python API."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from rich.progress import track

from armcell.collision import ExactChecker
from armcell.core import SE3, Box, Cylinder, PlanRequest, PoseGoal
from armcell.kinematics import kinematic_tree
from armcell.model import load_robot
from armcell.planning import plan
from armcell.scene import CollisionObject, PlanningScene

GROUP = "arm"


def pose_goals(count: int, seed: int = 0) -> list[dict[str, Any]]:
    """Plan from home to random reachable, free poses of a Panda's tip over a table.

    `us` is the process's CPU time of one `plan` call, the fastest of three.
    """
    model = load_robot("panda")
    solid = CollisionObject.single
    scene = PlanningScene.of(
        model,
        objects=[
            solid("table", Box(0.8, 1.4, 0.04), SE3.from_xyz(0.55, 0.0, 0.1)),
            solid("box", Box(0.1, 0.3, 0.3), SE3.from_xyz(0.55, 0.0, 0.271)),
            solid("can", Cylinder(0.04, 0.2), SE3.from_xyz(0.5, 0.4, 0.221)),
        ],
    )
    group = model.group(GROUP)
    judge, tree = ExactChecker(scene, group.joint_names), kinematic_tree(model)
    columns, rng = list(model.columns(group.joint_names)), np.random.default_rng(seed)
    rows = []
    for index in track(range(count), "pose goals", transient=True):
        q = scene.positions.copy()
        while True:
            q[columns] = rng.uniform(model.lower[columns], model.upper[columns])
            pose = tree.link_pose(q, group.tip_link)
            if judge.is_free(q[columns]) and pose.translation[2] > 0.2:
                break
        request = PlanRequest(GROUP, (PoseGoal(pose),), seed=seed)
        best, result = np.inf, None
        for _ in range(3):
            began = time.process_time()
            result = plan(scene, request)
            best = min(best, time.process_time() - began)
        rows.append({"index": index, "solved": result.code.ok, "us": best * 1e6})
    return rows
