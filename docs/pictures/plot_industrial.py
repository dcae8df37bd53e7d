"""The picture of docs/industrial_motions.md. Run: python docs/pictures/plot_industrial.py"""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

import armcell
from armcell.core import JointState, JointTrajectory, PlanRequest, PoseGoal, SequenceRequest
from armcell.planning import plan, plan_sequence
from armcell.scene import PlanningScene

TIP = "panda_hand_tcp"
STEP = 0.002  # [s]

scene = PlanningScene.of(armcell.load_robot("panda"))
here = scene.frame_pose(TIP)


def analytic(planner: str, goal, **options) -> PlanRequest:
    return PlanRequest("arm", (PoseGoal(goal),), pipeline_id="pilz", planner_id=planner, velocity_scaling=0.3,
                       acceleration_scaling=0.2, **options)  # fmt: skip


def tip_along(trajectory: JointTrajectory) -> tuple[np.ndarray, np.ndarray]:
    times = np.arange(0.0, trajectory.duration, STEP)
    states = (JointState(trajectory.joint_names, trajectory.sample(t)[0]) for t in times)
    return times, np.array([scene.with_state(s).frame_pose(TIP).translation for s in states])


def speed_of(points: np.ndarray) -> np.ndarray:
    return np.linalg.norm(np.diff(points, axis=0), axis=1) / STEP


left = here.shifted(y=0.25)
interim = tuple(here.shifted(y=0.1, z=-0.1).translation)
single = {
    "PTP": plan(scene, analytic("PTP", left)),
    "LIN": plan(scene, analytic("LIN", left)),
    "CIRC": plan(scene, analytic("CIRC", left, parameters={"interim": interim})),
}
corner, low = here.shifted(y=0.25), here.shifted(y=0.25, z=-0.2)
sequences = {
    f"radius {radius * 1000:.0f} mm": plan_sequence(
        scene, SequenceRequest(((analytic("LIN", corner), radius), (analytic("LIN", low), 0.0)))
    )
    for radius in (0.0, 0.05, 0.1)
}

figure, ((ways, speeds), (corners, passing)) = plt.subplots(2, 2, figsize=(9, 6.5), layout="constrained")
for (way, speed), results in (((ways, speeds), single), ((corners, passing), sequences)):
    for name, result in results.items():
        times, points = tip_along(result.trajectory)
        way.plot(points[:, 1], points[:, 2], label=name)
        speed.plot(times[1:], speed_of(points), label=f"{name}, {result.trajectory.duration:.2f} s")
    way.set(xlabel="y of the tip [m]", ylabel="z of the tip [m]", aspect="equal")
    speed.set(xlabel="time [s]", ylabel="speed of the tip [m/s]")
    way.legend(fontsize=8)
    speed.legend(fontsize=8)
    speed.grid(alpha=0.3)
ways.set_title("One motion")
corners.set_title("Two LIN in a sequence")
file = Path(__file__).parent / "industrial_motions.png"
figure.savefig(file, dpi=90)
