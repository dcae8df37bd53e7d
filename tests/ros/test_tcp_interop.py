"""Our ROS-TCP client, in Unity's place, at Unity's own ROS-TCP-Endpoint in a real ROS 1 graph.

Needs Debian's rospy and rosmaster, and a folder holding the endpoint's package `ros_tcp_endpoint` (its `src`
for ROS 1), named by ARMCELL_ROS_TCP_ENDPOINT.
"""

import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from armcell.ros import Bus, schema
from armcell.ros.tcp import ForwardedNames, RosTcpClient

pytestmark = pytest.mark.interop
SYSTEM_PYTHON = "/usr/bin/python3"
ENDPOINT = """
import rospy, sys
from ros_tcp_endpoint import TcpServer
rospy.init_node("unity_endpoint")
TcpServer(rospy.get_name(), tcp_ip="127.0.0.1", tcp_port=int(sys.argv[1])).start()
rospy.spin()
"""
ROS_SIDE = """
import rospy
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, SetBoolResponse, Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
rospy.init_node("planner")
rospy.Service("/plan", SetBool, lambda r: SetBoolResponse(r.data, "planned by rospy"))
out = rospy.Publisher("/planned_trajectory", JointTrajectory, queue_size=1, latch=True)
state = rospy.wait_for_message("/joint_states", JointState, timeout=20)
rospy.wait_for_service("/grip", timeout=20)
answer = rospy.ServiceProxy("/grip", Trigger)()
points = [JointTrajectoryPoint(positions=state.position, time_from_start=rospy.Duration(1.5))]
out.publish(JointTrajectory(joint_names=[answer.message], points=points))
rospy.spin()
"""


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as free:
        return free.getsockname()[1]


@pytest.fixture
def graph(tmp_path):
    """A ROS master, the endpoint and a node that plans; gives the endpoint's port."""
    folder = os.environ.get("ARMCELL_ROS_TCP_ENDPOINT", "")
    if not (Path(folder) / "ros_tcp_endpoint" / "server.py").exists():
        pytest.skip("ARMCELL_ROS_TCP_ENDPOINT names no folder with Unity's ros_tcp_endpoint")
    if subprocess.run([SYSTEM_PYTHON, "-c", "import rospy, rosmaster"], capture_output=True).returncode:
        pytest.skip("Debian's rospy is not installed (apt install python3-rospy python3-rosmaster)")
    master, port = free_port(), free_port()
    environment = {
        "PATH": "/usr/bin:/bin",
        "HOME": str(tmp_path),
        "PYTHONPATH": folder,
        "ROS_MASTER_URI": f"http://127.0.0.1:{master}",
        "ROS_IP": "127.0.0.1",
        "ROS_LOG_DIR": str(tmp_path),
    }

    def start(*arguments):
        log = (tmp_path / f"{len(started)}.log").open("w")
        started.append(subprocess.Popen(arguments, env=environment, stdout=log, stderr=log))

    started = []
    try:
        start("/usr/bin/rosmaster", "--core", "-p", str(master))
        wait_for_port(master)
        start(SYSTEM_PYTHON, "-c", ENDPOINT, str(port))
        wait_for_port(port)
        start(SYSTEM_PYTHON, "-c", ROS_SIDE)
        yield port
    finally:
        for process in reversed(started):
            process.terminate()
            process.wait(10)
        for log in sorted(tmp_path.glob("?.log")):
            sys.stdout.write(log.read_text())


def wait_for_port(port):
    end = time.monotonic() + 20
    while time.monotonic() < end:
        try:
            socket.create_connection(("127.0.0.1", port), timeout=1).close()
            return
        except OSError:
            time.sleep(0.05)
    pytest.fail(f"nothing listens on {port}")


def test_the_simulator_stands_where_unity_stands(graph):
    bus = Bus()
    request, _ = schema().service("std_srvs/SetBool")
    _, response = schema().service("std_srvs/Trigger")
    bus.serve("/grip", "std_srvs/Trigger", lambda _: response(True, "gripped"))
    bridge = ForwardedNames(
        publish={"/joint_states": "sensor_msgs/JointState"},
        subscribe={"/planned_trajectory": "trajectory_msgs/JointTrajectory"},
        implement={"/grip": "std_srvs/Trigger"},
        use={"/plan": "std_srvs/SetBool"},
    )
    planned = bus.subscribe("/planned_trajectory", "trajectory_msgs/JointTrajectory")
    with RosTcpClient(bus, "127.0.0.1", graph, bridge) as client:
        assert client.wait_connected(10)
        states = bus.advertise("/joint_states", "sensor_msgs/JointState")
        trajectory, end = None, time.monotonic() + 30
        while trajectory is None and time.monotonic() < end:
            state = schema().new("sensor_msgs/JointState", header=bus.header(), name=["a", "b"])
            state.position = np.array([0.25, -1.5])
            states.publish(state)
            trajectory = planned.get(0.033)
        assert trajectory is not None
        assert trajectory.joint_names == ["gripped"]  # rospy called our service by way of the endpoint
        assert trajectory.points[0].positions.tolist() == [0.25, -1.5]  # and got our joint states
        assert trajectory.points[0].time_from_start.to_sec() == 1.5
        answer = bus.call("/plan", request(True))
        assert answer.success and answer.message == "planned by rospy"
        assert client.connections == 1  # nothing we sent made the endpoint drop us
