"""A made-up but plausible Panda pick and place, without physics: smooth joints, a cube that rises."""

from __future__ import annotations

import numpy as np

from armcell.core import SE3, Box, Event, JointState, JointTrajectory, Plane, StateSample
from armcell.kinematics import kinematic_tree
from armcell.model import load_robot
from armcell.scene import CollisionObject, PlanningScene

STAGES = [  # name, planner, seconds, arm pose at its end, finger joint at its end [m]
    ("open gripper", "gripper", 0.4, [0, -0.785, 0, -2.356, 0, 1.571, 0.785], 0.04),
    ("move to pregrasp", "RRTConnect", 2.1, [0.35, 0.10, 0.05, -2.20, 0.0, 2.30, 1.15], 0.04),
    ("approach", "cartesian", 0.9, [0.35, 0.34, 0.05, -2.12, 0.0, 2.46, 1.15], 0.04),
    ("close gripper", "gripper", 0.5, [0.35, 0.34, 0.05, -2.12, 0.0, 2.46, 1.15], 0.025),
    ("lift", "cartesian", 1.0, [0.35, 0.05, 0.05, -2.15, 0.0, 2.20, 1.15], 0.025),
    ("hold", "none", 5.0, [0.35, 0.05, 0.05, -2.15, 0.0, 2.20, 1.15], 0.025),
    ("move to preplace", "RRTConnect", 3.0, [-0.75, 0.12, -0.1, -2.05, 0.0, 2.17, 0.20], 0.025),
    ("lower", "cartesian", 0.9, [-0.75, 0.36, -0.1, -1.95, 0.0, 2.31, 0.20], 0.025),
    ("open gripper", "gripper", 0.4, [-0.75, 0.36, -0.1, -1.95, 0.0, 2.31, 0.20], 0.04),
    ("retreat", "cartesian", 0.8, [-0.75, 0.08, -0.1, -2.05, 0.0, 2.13, 0.20], 0.04),
    ("go home", "RRTConnect", 2.4, [0, -0.785, 0, -2.356, 0, 1.571, 0.785], 0.04),
]


def panda_scene() -> PlanningScene:
    cube = CollisionObject.single(
        "cube", Box(0.05, 0.05, 0.05), SE3.from_xyz(0.5, 0.1, 0.025), color=(0.84, 0.37, 0, 1), movable=True
    )
    wall = CollisionObject.single("wall", Box(0.02, 0.3, 0.3), SE3.from_xyz(0.45, -0.2, 0.15))
    return PlanningScene.of(
        load_robot("panda"), objects=[cube, wall, CollisionObject.single("floor", Plane())]
    )


def play(scene: PlanningScene, observer, rate: float = 500.0) -> float:
    """Send a whole run to an observer; returns the time of its end [s]."""
    model, tree = scene.model, kinematic_tree(scene.model)
    arm = model.group("arm").joint_names
    at = model.columns(arm)
    finger = model.columns(("panda_finger_joint1",))[0]
    q, time, held = np.array(scene.positions), 0.0, None
    T_cube = scene.object("cube").T_world_object
    rng = np.random.default_rng(3)
    for name, planner, seconds, goal, width in STAGES:
        observer.on_event(Event(time, "stage", name, {"phase": "begin", "planner": planner}))
        start, end = q.copy(), q.copy()
        end[at], end[finger] = goal, width
        if np.ptp(end[at] - start[at]) > 0:
            s = np.linspace(0, 1, 25)
            positions = start[at] + np.outer(10 * s**3 - 15 * s**4 + 6 * s**5, end[at] - start[at])
            observer.on_trajectory(time, JointTrajectory(arm, seconds * s, positions))
        steps = max(2, round(seconds * rate))
        for k in range(1, steps + 1):
            s = k / steps
            q = start + (10 * s**3 - 15 * s**4 + 6 * s**5) * (end - start)
            v = (30 * s**2 - 60 * s**3 + 30 * s**4) * (end - start) / seconds
            force = 0.0
            if width == 0.025:
                force = 32.0 * (min(1.0, 2 * s) if name == "close gripper" else 1.0) + rng.normal(0, 0.15)
            if held is not None and width == 0.025:
                T_cube = SE3.from_matrix(tree.link_transforms(q)[tree.link_index["panda_hand_tcp"]]) @ held
            effort = 4 * v + rng.normal(0, 0.05, len(v))
            state = JointState(model.joint_names, q, v, effort, time + s * seconds)
            observer.on_state(
                StateSample(
                    time + s * seconds, state, {"cube": T_cube}, {"hand": 2 * q[finger]}, {"hand": force}
                )
            )
        time += seconds
        if name == "close gripper":
            T_tcp = SE3.from_matrix(tree.link_transforms(q)[tree.link_index["panda_hand_tcp"]])
            held = T_tcp.inverse() @ T_cube
            observer.on_event(
                Event(time, "grasp", "cube held by friction, 32.0 N per finger", {"object": "cube"})
            )
        observer.on_event(Event(time, "stage", name, {"phase": "end", "ok": True, "error": ""}))
    return time


def panda_result() -> dict:
    """The JSON of such a run."""
    rng = np.random.default_rng(5)
    stages = [
        {
            "name": name,
            "planner": planner,
            "planning_time_s": float(rng.uniform(0.01, 0.09)) if planner != "none" else None,
            "motion_time_s": seconds,
            "clearance_m": float(rng.uniform(0.012, 0.06)) if planner not in ("none", "gripper") else None,
            "slip_m": 6.3e-5 if name == "hold" else None,
            "error": None,
            "ok": True,
        }
        for name, planner, seconds, *_ in STAGES
    ]
    return {
        "success": True,
        "error_code": 1,
        "error_name": "SUCCESS",
        "message": "cube placed in the tray, 0.41 mm from its target",
        "cell": "panda_pick",
        "task": "pick and place cube",
        "mode": "sim",
        "seed": 7,
        "stages": stages,
        "slip_m": 6.3e-5,
        "placement_error_m": 4.1e-4,
        "unwanted_contacts": [],
        "min_clearance_m": 0.0123,
        "welds": [],
        "versions": {
            "armcell": "0.1.0",
            "mujoco": "4.0.0",
            "ompl": "2.0.1",
            "numpy": "2.4.6",
            "python": "3.11.2",
        },
        "command": "armcell run panda_pick --seed 7 --headless",
    }
