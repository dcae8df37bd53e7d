"""The first reference system's scenario: a Panda grasps a cube and lifts it, in each arrangement."""

from __future__ import annotations

import re
import subprocess
import sys
import time

import numpy as np
import pytest
from tests.programs import Program
from tests.ros.helpers import remote_cell
from tests.ros.unity_like import UnityLike
from tests.ros.unity_sim import UnitySim
from tests.sizes import seeds

from armcell.cell import load
from armcell.core import InputError
from armcell.ros import Bus, Ros1Graph, Ros1Settings, cdr_codec, schema
from armcell.ros.codec import ros1_codec
from armcell.ros.nodes import GraspServer, GraspServerSettings, ServedCell, ServedPlanner
from armcell.ros.tcp import ForwardedNames, RosTcpClient, RosTcpServer, ServerSettings

S = schema()
TRIGGER = "std_srvs/Trigger"
CELL = "panda_table"


def height(poses):
    return float(poses["cube"].translation[2])


@pytest.mark.slow
@pytest.mark.parametrize("seed", seeds(1, [0, 3]))
def test_all_in_one_process(seed):
    bus = Bus()
    live = load(CELL).connect("sim", seed, time_scale=4.0)
    with ServedCell(live, bus) as served:
        before = height(served.node.conductor.call(live.driver.object_poses))
        told = bus.subscribe("/grasp_status", "std_msgs/String", queue_size=50)
        answer = bus.call("/grasp", S.new("std_srvs/TriggerRequest"))
        assert answer.success, answer.message
        assert height(served.node.conductor.call(live.driver.object_poses)) - before > 0.15
        assert served.cell.held_object(live.model.gripper("hand")) == "cube"
        assert not served.node.conductor.call(live.driver.unwanted_contacts)
        said = []
        while (message := told.get(0.1)) is not None:
            said.append(message.data)
        assert said[0] == "grasping cube" and said[-1] == "done: cube is lifted" and "cube: monitor" in said
        plans = {e.text: e.data for e in live.ctx.events if e.kind == "plan"}
        assert {"move to pre-grasp", "approach", "lift"} <= set(plans) and all(
            (plan["points"] > 2 and "goal" in plan["evidence"]) or "planned" in plan["evidence"]
            for plan in plans.values()
        )
        again = bus.call("/grasp", S.new("std_srvs/TriggerRequest"))  # it is held already
        assert not again.success and "can be moved" in again.message


@pytest.mark.long
@pytest.mark.parametrize("protocol", ["ROS1", "ROS2"])
def test_simulator_and_planner_in_two_processes(protocol, tmp_path):
    def start(*arguments):
        return Program(
            [sys.executable, "-u", "-m", "armcell", *arguments],
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip

    planner = start("serve", CELL, "--unity", "--port", "0", "--plan-only", "--protocol", protocol)
    simulator = None
    try:
        assert planner.stdout is not None
        port = re.search(r":(\d+);", planner.stdout.readline())
        assert port
        where = f"127.0.0.1:{port[1]}"
        simulator = start("sim", CELL, "--connect", where, "--time-scale", "2")
        bus = Bus()
        bridge = ForwardedNames(
            subscribe={"/object_pose": "geometry_msgs/PoseStamped"}, use={"/grasp": TRIGGER}
        )
        with RosTcpClient(bus, "127.0.0.1", int(port[1]), bridge, service_timeout=120.0) as client:
            poses = bus.subscribe("/object_pose", "geometry_msgs/PoseStamped", queue_size=1)
            assert client.wait_connected(20)
            first = poses.get(60)
            assert first is not None
            answer = bus.call("/grasp", S.new("std_srvs/TriggerRequest"))
            assert answer.success, answer.message
            last = poses.get(5)
            assert last.pose.position.z - first.pose.position.z > 0.15
    finally:
        for process in (simulator, planner):
            if process is not None:
                process.terminate()
                process.wait(20)


@pytest.mark.slow
def test_simulator_and_planner_joined_through_a_ros1_graph():
    """Two buses and nothing between them but our own master; with Debian's: ros1/test_interop_cell."""
    live, cell = load(CELL).connect("sim", 0, time_scale=4.0), load(CELL)
    simulator, planner = Bus(), Bus()
    with ServedCell(live, simulator, plan=False) as served:
        own = Ros1Settings("simulator", master="http://127.0.0.1:0", own_master=True)
        with Ros1Graph(simulator, own) as graph:
            before = height(served.node.conductor.call(live.driver.object_poses))
            joined = Ros1Settings("planner", master=graph.node.master, own_master=False)
            with Ros1Graph(planner, joined), ServedPlanner(cell, planner):
                assert simulator.wait_for_service("/grasp", 20)  # through the graph
                answer = simulator.call("/grasp", S.new("std_srvs/TriggerRequest"))
            assert answer.success, answer.message
            assert height(served.node.conductor.call(live.driver.object_poses)) - before > 0.15


@pytest.mark.slow
@pytest.mark.cases("False")
@pytest.mark.parametrize("ros2", [False, True])
def test_a_unity_like_client_asks_the_server_to_grasp(ros2):
    """armcell simulates and plans; the client presses the button and watches the cube."""
    codec, bus = cdr_codec() if ros2 else ros1_codec(), Bus()
    live = load(CELL).connect("sim", None, time_scale=4.0)
    with (
        ServedCell(live, bus),
        RosTcpServer(bus, ServerSettings(port=0)) as server,
        UnityLike(server.address, ros2) as unity,
    ):
        unity.register("__subscribe", "/object_pose", "geometry_msgs/PoseStamped")
        unity.register("__ros_service", "/grasp", TRIGGER)
        number = unity.call("/grasp", bytes(codec.encode(S.new("std_srvs/TriggerRequest"))))
        z, answer, end = [], None, time.monotonic() + 60
        while answer is None and time.monotonic() < end:
            name, body = unity.read(20)
            if name == "/object_pose":
                z.append(codec.decode("geometry_msgs/PoseStamped", body).pose.position.z)
            elif name == "__response" and body["srv_id"] == number:
                answer = codec.decode("std_srvs/TriggerResponse", unity.read_until("/grasp"))
        assert answer is not None and answer.success, answer
        assert max(z) - z[0] > 0.15


@pytest.mark.slow
@pytest.mark.cases("True")
@pytest.mark.parametrize("ros2", [False, True])
def test_unity_simulates_and_the_planner_grasps_with_it(ros2):
    """Unity has the robot and the cube; armcell plans, and knows the outcome from the joints alone."""
    cell, bus = load(CELL), Bus()
    scene = cell.scene()
    cube = scene.objects["cube"].T_world_object
    with ServedPlanner(cell, bus), RosTcpServer(bus, ServerSettings(port=0)) as server:
        unity = UnitySim(
            server.address,
            cell.model,
            cdr_codec() if ros2 else ros1_codec(),
            scene.positions,
            cube,
            ros2=ros2,
        )
        try:
            answer = bus.call("/grasp", S.new("std_srvs/TriggerRequest"))
            assert answer.success, answer.message
            assert unity.cube.translation[2] - cube.translation[2] > 0.15
            assert len(unity.received) == 3  # to the pre-grasp, down, up
            points = unity.received[0].points
            assert points[0].time_from_start.to_nsec() == 0 and len(points[0].velocities) == 7
        finally:
            unity.close()


@pytest.mark.slow
def test_without_a_simulator_the_planner_says_what_to_look_at(monkeypatch):
    monkeypatch.setattr("armcell.ros.nodes.remote_driver.STATE_TIMEOUT", 0.2)
    cell = remote_cell(Bus(), load(CELL).scene())
    with pytest.raises(InputError, match=r"no /joint_states yet .*simulator running"):
        cell.scene()
    cell.close()


def test_settings_of_the_grasp_server():
    assert (GraspServerSettings().above, GraspServerSettings().lift) == (0.10, 0.20)
    for bad in ({"above": 0.0}, {"lift": -1.0}, {"planning_time": 0.0}):
        with pytest.raises(InputError):
            GraspServerSettings(**bad)


@pytest.mark.slow
def test_grasps_are_aligned_with_the_edges_and_approach_as_they_say():
    cell, bus = load(CELL), Bus()
    scene = cell.scene(1)  # the cube turned
    remote = remote_cell(bus, scene)
    server = GraspServer(remote, bus)
    try:
        item = scene.objects["cube"]
        grasps = server._grasps(scene, item, "panda_arm", "panda_hand_tcp")
        from armcell.ros.convert import pose_from_message

        assert len(grasps) == 8 and [g.grasp_quality for g in grasps] == sorted(
            (g.grasp_quality for g in grasps), reverse=True
        )
        for grasp in grasps:
            T = pose_from_message(grasp.grasp_pose.pose)
            edges = item.T_world_object.rotation.matrix.T @ T.rotation.matrix
            assert np.allclose(np.abs(edges).max(axis=0), 1.0, atol=1e-6)  # its axes are the cube's
            d = grasp.pre_grasp_approach.direction.vector
            assert np.allclose(T.rotation.matrix[:, 2], (d.x, d.y, d.z), atol=1e-6)  # the hand looks ahead
            assert grasp.post_grasp_retreat.desired_distance == pytest.approx(0.2)
    finally:
        server.close()
        remote.close()
