"""Analytic motions: PTP, LIN and CIRC, and a sequence of them without stops.

python examples/12_ptp_lin_circ.py
"""

import numpy as np

import armcell
from armcell.core import SE3, Box, JointState, NamedGoal, PlanRequest, PoseGoal, SequenceRequest
from armcell.planning import plan, plan_sequence
from armcell.scene import CollisionObject, PlanningScene

robot = armcell.load_robot("panda")
scene = PlanningScene.of(robot)
here = scene.frame_pose("panda_hand_tcp")


def analytic(planner, goal, speed=0.3, **options):
    """Speed and acceleration are shares: of the joints' limits for PTP, of the tip's for LIN and CIRC."""
    goal = PoseGoal(goal) if isinstance(goal, SE3) else goal
    return PlanRequest("arm", (goal,), pipeline_id="pilz", planner_id=planner, velocity_scaling=speed,
                       acceleration_scaling=speed, **options)  # fmt: skip


def path_of(result):
    """Where the tip is, every 10 ms."""
    times = np.arange(0.0, result.trajectory.duration, 0.01)
    states = (JointState(result.trajectory.joint_names, result.trajectory.sample(t)[0]) for t in times)
    return times, np.array([scene.with_state(s).frame_pose("panda_hand_tcp").translation for s in states])


# PTP: all joints start, cruise, brake and end together. The path of the tip is not specified.
left, low = here.shifted(y=0.2), here.shifted(y=0.2, z=-0.2)
result = plan(scene, analytic("PTP", left))
share = (result.trajectory.positions - result.trajectory.positions[0]) / np.ptp(
    result.trajectory.positions, axis=0
)
print(f"PTP: {result.code.name}, {result.trajectory.duration:.2f} s; "
      f"the joints are apart by at most {np.ptp(np.abs(share), axis=1).max():.1e} of their ways")  # fmt: skip

# LIN: the tip keeps a line, with a trapezoid for its speed.
result = plan(scene, analytic("LIN", left))
times, points = path_of(result)
off = np.abs(points[:, [0, 2]] - here.translation[[0, 2]]).max()
speed = np.linalg.norm(np.diff(points, axis=0), axis=1) / 0.01
print(
    f"LIN: {result.trajectory.duration:.2f} s, {off * 1e6:.2f} um off its line, {speed.max():.3f} m/s at most"
)

# CIRC: through an interim point, or around a center (the shorter arc).
center = here.shifted(y=0.1).translation
for name, point in (("interim", here.shifted(y=0.1, z=-0.1)), ("center", here.shifted(y=0.1, z=0.02))):
    result = plan(scene, analytic("CIRC", left, parameters={name: tuple(point.translation)}))
    points = path_of(result)[1]
    radii = np.linalg.norm(points - (center if name == "interim" else point.translation), axis=1)
    print(f"CIRC by {name}: {result.code.name}, radius {radii.min() * 1e3:.2f} to "
          f"{radii.max() * 1e3:.2f} mm, {np.ptp(points[:, 2]) * 1e3:.1f} mm high")  # fmt: skip

# A sequence: after each motion a blend radius, inside of which it goes over into the next.
items = (
    analytic("LIN", left),
    analytic("LIN", low),
    analytic("LIN", here.shifted(z=-0.2)),
    analytic("PTP", NamedGoal("home")),
)
for radius in (0.0, 0.06):
    radii = (radius, radius, radius, 0.0)
    result = plan_sequence(scene, SequenceRequest(tuple(zip(items, radii, strict=True))))
    near = np.linalg.norm(path_of(result)[1] - left.translation, axis=1).min()
    print(f"sequence, radius {radius * 1e3:.0f} mm: {result.code.name}, {result.trajectory.duration:.2f} s, "
          f"passes the first corner at {near * 1e3:.1f} mm")  # fmt: skip

# An impossible motion is rejected, with a hint.
result = plan(scene, analytic("LIN", here.shifted(0.05, 0.2, -0.15), speed=1.0))
print(result.explain().text())
post = CollisionObject.single("post", Box(0.05, 0.05, 0.5), left)
result = plan(scene.with_object(post), analytic("LIN", here.shifted(y=0.4)))
print(result.explain().text())
