"""A document's script as the controller of a simulator in another process, over each wire."""

from __future__ import annotations

import re
import signal
import socket

import pytest
from tests.cli.helpers import finished, start
from tests.documents.running import indented
from tests.documents.test_pick_place import GRASPS, HEAD, PLACES, POSES, STAMPED, TASK, part
from tests.documents.test_unity_moveit import CELL, MAIN, grasp_pose, launch, server

from armcell.ros import Bus
from armcell.ros.tcp import ForwardedNames, RosTcpClient

pytestmark = pytest.mark.slow
# The script guesses when a motion has ended, 0.5 s late in the simulator's time: a busy machine needs it all.
SLOW = "0.5"
LIFTED = """
    rospy.sleep(0.5)
    heights = server.planning_scene.get_object_poses(["cube"])
    attached = server.planning_scene.get_attached_objects(["cube"])
    print("attached", sorted(attached))
    print("height", rospy.wait_for_message("/object_pose", PoseStamped, 5.0).pose.position.z)
"""


@pytest.fixture
def script(tmp_path):
    file = tmp_path / "grasp_action_server.py"
    file.write_text(server() + grasp_pose() + MAIN + LIFTED)
    return file


def free_address():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"127.0.0.1:{probe.getsockname()[1]}"


def check(said):
    assert said.status == 0, said.err
    assert "Planning failed" not in said.err and "attached ['cube']" in said.out, said.err + said.out
    (height,) = re.findall(r"height ([\d.]+)", said.out)
    assert float(height) > 0.17, said.err + said.out


def test_the_script_lifts_the_cube_of_a_simulator_over_ros_tcp(script):
    """What the launch file starts: an endpoint, a planner that moves nothing itself, and the script."""
    (port_in_text,) = [p.get("value") for p in launch().iter("param") if p.get("name") == "tcp_port"]
    assert port_in_text == "10000"  # armcell's default; here a free one, for tests may run beside each other
    where = free_address()
    controller = start("run", script, "--cell", CELL, "--unity", where, "--plan-only")
    simulator = start("sim", CELL, "--connect", where, "--time-scale", SLOW, "--auto-grip", "--no-record")
    try:
        check(finished(controller, 120))
    finally:
        simulator.terminate()
        finished(simulator)


@pytest.mark.realtime
def test_the_script_lifts_the_cube_of_a_simulator_over_ros1(script, monkeypatch):
    monkeypatch.setenv("ROS_MASTER_URI", f"http://{free_address()}")
    monkeypatch.setenv("ROS_IP", "127.0.0.1")
    controller = start("run", script, "--cell", CELL, "--ros1", "--own-master", "--plan-only")
    simulator = None
    try:
        for line in controller.stderr:
            if "waiting for /joint_states" in line:
                break
        options = ("--ros1", "--no-own-master", "--time-scale", SLOW, "--auto-grip", "--no-record")
        simulator = start("sim", CELL, *options)
        check(finished(controller, 120))
    finally:
        for process in (controller, simulator):
            if process is not None and process.poll() is None:
                process.terminate()
                finished(process)


@pytest.mark.realtime
def test_the_script_lifts_the_cube_of_a_simulator_over_ros2(script, monkeypatch):
    pytest.importorskip("cyclonedds")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    controller = start("run", script, "--cell", CELL, "--ros2", "--domain", "209", "--plan-only")
    options = ("--ros2", "--domain", "209", "--time-scale", SLOW, "--auto-grip", "--no-record")
    simulator = start("sim", CELL, *options)
    try:
        check(finished(controller, 120))
    finally:
        simulator.terminate()
        finished(simulator)


@pytest.mark.realtime
def test_pick_and_place_of_the_second_document_over_ros_tcp(tmp_path):
    """The arm of another process picks and places: `pick`, `go` and `place` follow its joint states."""
    file = tmp_path / "pick_place.py"
    task = "def task():\n" + indented(part(*TASK)) + "    return grasp_result, place_result\n"
    end = """
grasps, place_locations = generate_grasps(target_pose), generate_place_locations(place_pose)
before = scene.get_object_poses(["object"])["object"].position
print("results", *map(int, task()))
rospy.sleep(0.5)
after = scene.get_object_poses(["object"])["object"].position
print("moved", round(after.x - before.x, 3), round(after.y - before.y, 3), round(after.z - before.z, 3))
"""
    file.write_text(HEAD + POSES + STAMPED + part(*GRASPS) + part(*PLACES) + task + end)
    where = free_address()
    controller = start("run", file, "--cell", "six_axis_table", "--unity", where, "--plan-only")
    simulator = start("sim", "six_axis_table", "--connect", where, "--time-scale", "2", "--no-record")
    try:
        said = finished(controller, 120)
    finally:
        simulator.terminate()
        finished(simulator)
    assert said.status == 0 and "results 1 1" in said.out, said.err + said.out
    x, y, z = map(float, said.out.split("moved")[1].split())
    assert abs(x) < 0.025 and abs(y + 0.25) < 0.025 and abs(z) < 3e-3


def test_plan_only_without_a_wire_is_refused(script, capsys):
    from armcell.cli.main import main

    assert main(["run", str(script), "--cell", CELL, "--plan-only"]) == 1
    assert "add --unity, --ros1 or --ros2" in capsys.readouterr().err
    assert main(["run", str(script), "--cell", CELL, "--plan-only", "--unity", "--view"]) == 1
    assert "--view needs a robot in this process" in capsys.readouterr().err


@pytest.mark.parametrize("names", [pytest.param((), marks=pytest.mark.realtime), ("--ns", "left")])
def test_without_plan_only_others_join_the_scripts_own_cell(tmp_path, names):
    """The robot is in the script's process; a client of the endpoint sees it move."""
    space = "".join(f"/{name}" for name in names[1:])
    client_is_here, joint_states = f"{space}/client_is_here", f"{space}/joint_states"
    file = tmp_path / "turn.py"
    file.write_text("""
import rospy
from moveit_commander import MoveGroupCommander
rospy.init_node("turn")
arm = MoveGroupCommander("panda_arm")
arm.set_max_velocity_scaling_factor(0.3)
first, *others = arm.get_current_joint_values()
while not rospy.get_published_topics("/client_is_here"):
    rospy.sleep(0.05)
assert arm.go([first + 0.5, *others])
rospy.sleep(0.5)
""")
    where = free_address()
    controller = start("run", file, "--cell", CELL, "--unity", where, "--mode", "fake", "--headless", *names)
    host, port = where.split(":")
    bus = Bus()
    here = bus.advertise(client_is_here, "std_msgs/String")
    bridge = ForwardedNames(
        publish={client_is_here: "std_msgs/String"}, subscribe={joint_states: "sensor_msgs/JointState"}
    )
    try:
        with RosTcpClient(bus, host, int(port), bridge) as client:
            states = bus.subscribe(joint_states, "sensor_msgs/JointState", queue_size=10_000)
            assert client.wait_connected(60)
            here.publish(bus.schema.new("std_msgs/String", "here"))
            said = finished(controller, 120)
            seen = []
            while (state := states.get(0.1)) is not None:
                seen.append(dict(zip(state.name, state.position))["panda_joint1"])
    finally:
        if controller.poll() is None:
            controller.terminate()
            finished(controller)
    assert said.status == 0, said.err
    assert max(seen) - min(seen) > 0.45


def test_a_simulator_that_ends_is_reported_and_ctrl_c_ends_the_script(tmp_path):
    file = tmp_path / "wait.py"
    file.write_text("import rospy\nrospy.init_node('wait')\nrospy.loginfo('begun')\nrospy.sleep(1000.0)\n")
    where = free_address()
    controller = start("run", file, "--cell", CELL, "--unity", where, "--plan-only")
    simulator = start("sim", CELL, "--connect", where, "--mode", "fake", "--no-record")
    try:
        seen = []
        for line in controller.stderr:
            seen.append(line)
            if "begun" in line:
                simulator.terminate()
                finished(simulator)
            if "no /joint_states for 5 s" in line:
                break
        assert any("waiting for /joint_states" in line for line in seen), seen
        controller.send_signal(signal.SIGINT)
        assert finished(controller).status == 130
    finally:
        for process in (controller, simulator):
            if process.poll() is None:
                process.kill()
                process.wait()
