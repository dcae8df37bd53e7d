"""Planning problems, and an independent judge of what plan() answers."""

from __future__ import annotations

import numpy as np
from tests.scene.helpers import DOWN, box, panda, ur10

from armcell.collision import ExactChecker
from armcell.core import SE3, JointGoal, JointState, JointTrajectory, PlanRequest, PlanResult
from armcell.scene import PlanningScene

STEP = 0.002  # [rad] between the configurations the judge looks at


def down(x: float, y: float, z: float) -> SE3:
    """A tip that points down."""
    return SE3(DOWN, np.array([x, y, z]))


def panda_wall() -> PlanningScene:
    """A low wall in front of the Panda, a table below it; the tip stands to the wall's right."""
    q = {"joint1": -0.46, "joint2": 0.3, "joint4": -2.2, "joint6": 2.5}
    wall = box("wall", (0.3, 0.02, 0.35), (0.55, 0.0, 0.175))
    table = box("table", (1.2, 1.6, 0.04), (0.4, 0.0, -0.021))
    return panda(wall, table, **q).with_padding(0.005)


def ur10_wall() -> PlanningScene:
    """A wall in front of the UR10; the arm at its right."""
    scene = ur10(
        box("wall", (0.6, 0.02, 0.9), (0.8, 0.0, 0.45)), box("table", (2, 2, 0.04), (0.5, 0, -0.021))
    )
    return scene.with_state(JointState(("shoulder_pan_joint",), [-0.8])).with_padding(0.005)


def walled_in() -> tuple[PlanningScene, JointGoal]:
    """A problem without solution: a wall all the way between the Panda's start and its goal."""
    walls = [
        box("front", (1.4, 0.002, 3.0), (0.85, 0.0, 0.5)),
        box("back", (1.4, 0.002, 3.0), (-0.85, 0.0, 0.5)),
        box("top", (0.3, 0.002, 1.4), (0.0, 0.0, 1.3)),
    ]
    scene = panda(*walls, joint1=np.pi / 2, joint2=1.0, joint4=-1.5)
    return scene, JointGoal(JointState(("panda_joint1",), [-np.pi / 2]))


def request(goal, **options) -> PlanRequest:
    return PlanRequest("arm", goal if isinstance(goal, tuple) else (goal,), **options)


def ends_at(scene: PlanningScene, result: PlanResult) -> PlanningScene:
    """The scene after the motion."""
    last = result.trajectory.positions[-1]
    return scene.with_state(JointState(result.trajectory.joint_names, last))


def judge(scene: PlanningScene, trajectory: JointTrajectory, v: float = 1.0, a: float = 1.0) -> None:
    """Free of contact every 2 mrad (without padding), within limits, from the scene's state to rest."""
    model, names = scene.model, trajectory.joint_names
    columns = model.columns(names)
    checker = ExactChecker(scene.with_padding(0.0), names)
    np.testing.assert_allclose(trajectory.positions[0], scene.positions[columns], atol=1e-9)
    velocity, acceleration = model.limits(names, "velocity"), model.limits(names, "acceleration")
    times = np.append(np.arange(0.0, trajectory.duration, 0.005), trajectory.duration)
    previous = trajectory.positions[0]
    for t in times:
        q, qd, qdd = trajectory.sample(t)
        assert np.all(np.abs(qd) <= v * velocity * 1.001) and np.all(np.abs(qdd) <= a * acceleration * 1.001)
        model.check_positions(q, names, margin=1e-6)
        n = max(int(np.ceil(np.max(np.abs(q - previous)) / STEP)), 1)
        for k in range(1, n + 1):
            at = previous + (q - previous) * k / n
            assert checker.is_free(at), checker.contacts(at)
        previous = q
    for values in (trajectory.velocities, trajectory.accelerations):
        assert not values[0].any() and not values[-1].any()
