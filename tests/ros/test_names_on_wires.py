"""Namespaces, remappings and latched topics are alike on every wire, also with --plan-only."""

import threading
import time
from contextlib import contextmanager

import numpy as np
import pytest
from tests.ros.unity_like import UnityLike

from armcell.cell import load
from armcell.core import InputError
from armcell.ros import ActionClient, Bus, GoalState, schema
from armcell.ros.codec import cdr_codec, ros1_codec
from armcell.ros.convert import joint_state_message
from armcell.ros.names import NameMap, name_map
from armcell.ros.nodes import ServedCell, ServedPlanner
from armcell.ros.ros1 import Ros1Graph, Ros1Settings
from armcell.ros.tcp import RosTcpServer, ServerSettings

S = schema()
CELL = "panda_pick"
REMAP = ("trajectory_status:=/words", "/arm_controller/follow_joint_trajectory:=/follow")
LATCHED = {  # as the cell's nodes call them
    "/robot_description": "std_msgs/String",
    "/robot_description_semantic": "std_msgs/String",
    "/move_group/monitored_planning_scene": "moveit_msgs/PlanningScene",
}


# --- the map ---
def test_names_go_there_and_back():
    names = name_map("cell", "left", [*REMAP, "joint_states:=q"])
    for own, outside in {
        "/joint_states": "/left/q",
        "/tf": "/tf",  # of the whole graph
        "/compute_ik": "/left/compute_ik",
        "/trajectory_status": "/words",
        "/arm_controller/follow_joint_trajectory/goal": "/follow/goal",
        "/arm_controller/follow_joint_trajectory/status": "/follow/status",
    }.items():
        assert (names.to_graph(own), names.to_bus(outside)) == (outside, own)
    assert name_map("cell", "left", ["/left/joint_states:=/q"]).to_graph("/joint_states") == "/q"
    assert name_map("cell") is None and isinstance(name_map("cell", "/left/"), NameMap)


@pytest.mark.parametrize("remap", [["a"], ["a:="], [":=b"], ["a:=b", "c:=b"], ["a:=4 b"]])
def test_what_is_no_remapping(remap):
    with pytest.raises(InputError):
        name_map("cell", "", remap)


def test_a_renamed_bus_maps_topics_services_and_parameters():
    bus = Bus()
    mine = bus.with_remapping(name_map("cell", "left", ["in:=/out"]))
    got, text = bus.subscribe("/out", "std_msgs/String"), S.new("std_msgs/String", "a")
    mine.advertise("/in", "std_msgs/String").publish(text)
    assert got.get(1) is text and [t.name for t in mine.topics()] == ["/in"]
    mine.serve("/ask", "std_srvs/Trigger", lambda _: S.new("std_srvs/TriggerResponse", True, "yes"))
    assert bus.call("/left/ask", S.new("std_srvs/TriggerRequest")).message == "yes"
    assert mine.services() == {"/ask": "std_srvs/Trigger"} and mine.wait_for_service("/ask", 0)
    mine.parameters.set("/robot_description", {"a": 1})
    assert bus.parameters.get("/left/robot_description/a") == 1 and "/robot_description/a" in mine.parameters
    assert mine.parameters.get("/") == {"robot_description": {"a": 1}}


# --- a cell's ---
@contextmanager
def a_cell(bus):
    with ServedCell(load(CELL).connect("fake", None, time_scale=10.0), bus):
        yield


@contextmanager
def a_planner(bus):
    """With --plan-only; what the simulator publishes comes from another thread, as over a wire."""
    scene, stop = load(CELL).scene(0), threading.Event()
    states = bus.advertise("/joint_states", "sensor_msgs/JointState")

    def simulate():
        while not stop.wait(0.05):
            states.publish(joint_state_message(S, bus.header(), scene.state))

    thread = threading.Thread(target=simulate)
    thread.start()
    try:
        with ServedPlanner(load(CELL), bus):
            yield
    finally:
        stop.set()
        thread.join()


@pytest.fixture(scope="module", params=[a_cell, a_planner], ids=["cell", "plan-only"])
def bus(request):
    """The bus as the wires have it; the cell is in a namespace."""
    found = Bus()
    with request.param(found.with_remapping(name_map("armcell", "arm_left", REMAP))):
        monitored = found.subscribe(
            "/arm_left/move_group/monitored_planning_scene", "moveit_msgs/PlanningScene"
        )
        assert monitored.get(20) is not None  # it has been published: who comes now is late
        monitored.close()
        yield found


@pytest.mark.slow
@pytest.mark.parametrize("ros2", [False, True], ids=["ROS1", "ROS2"])
def test_unity_gets_latched_topics_late_and_by_their_names(bus, ros2):
    codec = cdr_codec() if ros2 else ros1_codec()
    with RosTcpServer(bus, ServerSettings(port=0)) as server, UnityLike(server.address, ros2) as unity:
        for name, kind in LATCHED.items():
            unity.register("__subscribe", f"/arm_left{name}", kind)
            message = codec.decode(kind, unity.read_until(f"/arm_left{name}", 10))
            assert message == S.message(kind) or message._type == kind
            if name == "/robot_description":
                assert message.data.lstrip().startswith("<") and "panda_finger_joint2" in message.data
        unity.command("__topic_list")
        listed = unity.read_until("__topic_list", 10)["topics"]
        assert "/words" in listed and "/tf" not in [n for n in listed if n.startswith("/arm_left")]


@pytest.mark.slow
@pytest.mark.cases("cell")
def test_ros1_gets_latched_topics_late_and_by_their_names(bus):
    there = Bus()
    settings = Ros1Settings("cell", namespace="/arm_left", master="http://127.0.0.1:0", own_master=True)
    with Ros1Graph(bus, settings, bus_is_graph=True) as cell:
        assert cell.node.name == "/arm_left/cell"
        joined = Ros1Settings("other", master=cell.master.uri, own_master=False)
        with Ros1Graph(there, joined):
            for name, kind in LATCHED.items():
                message = there.subscribe(f"/arm_left{name}", kind).get(20)
                assert message is not None and message._type == kind, name
            assert "<robot" in there.parameters.get("/arm_left/robot_description")


@pytest.mark.parametrize("bus", [a_cell], indirect=True, ids=["cell"])
def test_a_remapped_action_moves_the_arm(bus):
    states = bus.subscribe("/arm_left/joint_states", "sensor_msgs/JointState", queue_size=1).get(5)
    arm = [(n, q) for n, q in zip(states.name, states.position) if "finger" not in n]
    goal = S.new("control_msgs/FollowJointTrajectoryGoal")
    Duration = S.message("builtin_interfaces/Duration")
    q = np.array([q for _, q in arm])
    points = [
        S.new("trajectory_msgs/JointTrajectoryPoint", positions=p, velocities=q * 0, time_from_start=t)
        for p, t in ((q, Duration.from_sec(0)), (q + 0.1, Duration.from_sec(1)))
    ]
    goal.trajectory = S.new("trajectory_msgs/JointTrajectory", joint_names=[n for n, _ in arm], points=points)
    words = bus.subscribe("/words", "std_msgs/String")
    with ActionClient(bus, "/follow", "control_msgs/FollowJointTrajectory") as client:
        sent = client.send_goal(goal)
        assert sent.wait(20) and sent.state is GoalState.SUCCEEDED, sent.text
    end = time.monotonic() + 5
    while not words.get(0.5).data.startswith("done"):
        assert time.monotonic() < end
