"""The arrangement the package is for: Unity simulates, armcell plans and grasps with it, over a real socket.

Unity is the package's own C# under Mono, on our stubs: its physics is kinematic.
"""

from __future__ import annotations

import re
import subprocess
import sys

import pytest
from tests import programs
from tests.programs import Program

from armcell.ros import Bus, schema
from armcell.ros.nodes import ServedPlanner
from armcell.ros.tcp import RosTcpServer, ServerSettings

S = schema()


@pytest.mark.slow
@pytest.mark.cases("False")
@pytest.mark.parametrize("ros2", [False, True])
def test_the_planner_grasps_in_unity(player, exported, scene, ros2):
    """What `armcell serve panda_table --unity --plan-only` serves; the cube is lifted by 0.2 m."""
    cell, _ = exported
    bus = Bus()
    with ServedPlanner(cell, bus), RosTcpServer(bus, ServerSettings(port=0)) as server:
        poses = bus.subscribe("/object_pose", "geometry_msgs/PoseStamped", queue_size=1)
        status = bus.subscribe("/trajectory_status", "std_msgs/String", queue_size=50)
        grip = bus.subscribe("/gripper_status", "std_msgs/String", queue_size=50)
        unity = player(ros2).join(scene, server.address, speed=3)
        try:
            first = poses.get(30)
            answer = bus.call("/grasp", S.new("std_srvs/TriggerRequest"))
            assert answer.success, answer.message
            last = poses.get(5)
            assert last.pose.position.z - first.pose.position.z == pytest.approx(0.2, abs=0.005)
            assert {c.protocol for c in server.clients()} == {"ROS2" if ros2 else "ROS1"}
            assert sum(c.errors for c in server.clients()) == 0
        finally:
            unity.stdin.close()
            try:
                unity.wait(20)
            except subprocess.TimeoutExpired:
                unity.kill()
        said = []
        while (message := status.get(0.2)) is not None:
            said.append(message.data.split(" ")[0])
        assert said == ["executing", "done:"] * 3  # to above the cube, down, up
        held = []
        while (message := grip.get(0.2)) is not None:
            held.append(message.data)
        assert held[-1] == "done: holds cube"


@pytest.mark.long
def test_the_commands_of_the_readme(player, scene):
    """`armcell serve ... --plan-only`, Unity, and `armcell service call /grasp`, each in a process."""
    command = [sys.executable, "-u", "-m", "armcell"]
    planner = Program(
        [*command, "serve", "panda_table", "--unity", "--port", "0", "--plan-only"],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    unity = None
    try:
        assert planner.stdout is not None
        port = re.search(r":(\d+);", planner.stdout.readline())
        assert port
        unity = player().join(scene, ("127.0.0.1", int(port[1])), speed=3)
        where = f"127.0.0.1:{port[1]}"
        call = [*command, "service", "call", "/grasp", "std_srvs/Trigger", "--connect", where]
        for _ in range(3):  # the planner may still be getting ready
            done = programs.run(call, capture_output=True, text=True, timeout=200)
            if done.returncode == 0:
                break
        assert done.returncode == 0 and "cube is lifted" in done.stdout, done.stdout + done.stderr
    finally:
        if unity is not None:
            unity.stdin.close()
            unity.wait(20)
        planner.terminate()
        planner.wait(20)
