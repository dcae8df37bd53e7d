"""The `real` mode without a robot: an emulated UR10 in this program, driven over UR's own protocols.

A trajectory is played by the robot, the pendant's slider halves its speed, a protective stop ends a motion,
and only `resume()` lets the arm move again.
"""

import time

import numpy as np

from armcell.core import JointTrajectory
from armcell.drivers import DashboardClient, DriverOptions, drivers
from armcell.emulators import ControllerSettings, UrRack
from armcell.execution import DriverWorld, MotionGate, execute
from armcell.model import load_robot
from armcell.scene import PlanningScene

HOST = "127.0.0.22"
# The state's age is wide because robot and driver share one Python here; the default is 0.05 s.
REAL = {"arms": {"arm": {"host": HOST, "model": "UR10"}}, "max_state_age": 0.4, "watchdog": 0.5}


def swing(driver, distance: float, seconds: float) -> JointTrajectory:
    """The base joint turns by a distance [rad], softly."""
    start, t = driver.joint_state().positions, np.linspace(0.0, seconds, 76)
    w, d = np.pi / seconds, np.array([distance, 0, 0, 0, 0, 0])
    shape = ((1 - np.cos(w * t)) / 2, w / 2 * np.sin(w * t), w * w / 2 * np.cos(w * t))
    q, v, a = (s[:, None] * d for s in shape)
    return JointTrajectory(load_robot("ur10").group("arm").joint_names, t, start + q, v, a)


scene = PlanningScene.of(load_robot("ur10"))
with (
    UrRack([ControllerSettings("UR10", HOST)]),
    drivers["real"](scene, DriverOptions(extra={"real": REAL})) as robot,
):
    gate = MotionGate(DriverWorld(robot, scene))  # proves every motion when it starts
    result = execute(robot, gate.motion(swing(robot, 0.5, 1.5)))
    print(f"full speed: {result.code.name} in {result.finished - result.started:.1f} s")

    robot.arms["arm"].set_slider(0.5)
    time.sleep(0.5)
    result = execute(robot, gate.motion(swing(robot, -0.5, 1.5)))
    print(f"slider at 50 %: {result.code.name} in {result.finished - result.started:.1f} s")
    robot.arms["arm"].set_slider(1.0)

    def somebody_gets_in_the_way(fraction: float) -> None:
        if fraction > 0.4 and robot.fault() is None:
            with DashboardClient(HOST) as dashboard:
                dashboard.ask("armcell protective stop")

    result = execute(robot, gate.motion(swing(robot, 0.5, 2.0)), progress=somebody_gets_in_the_way)
    print(f"stopped: {result.code.name}: {result.message}")

    with DashboardClient(HOST) as dashboard:
        dashboard.ask("unlock protective stop")
    time.sleep(0.5)
    robot.resume()
    print(f"resumed: {execute(robot, gate.motion(swing(robot, 0.2, 1.0))).code.name}")
    for event in robot.safety_events:
        print(f"  {event.arm}: {event.kind}: {event.text}")
