"""A cell in a ROS 2 domain: driven by a plain DDS program, and in two processes that share nothing else."""

import os
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from tests.programs import Program

from armcell.cell import load
from armcell.ros import Bus, CellNode, Ros2Bridge, Ros2Settings, schema
from armcell.ros.names import name_map
from armcell.ros.nodes import ServedCell

pytestmark = pytest.mark.slow
S = schema()
ARM = "/arm_controller/follow_joint_trajectory"
CANCEL = f"{ARM}/_action/cancel_goal"


@pytest.fixture
def cell(reach):
    """A Panda that follows exactly, as a ROS 2 node; joined before the peer asks."""
    node = CellNode(load("panda_pick").connect("fake", 0, time_scale=4.0), Bus())
    with Ros2Bridge(node.bus, Ros2Settings(reach, distro="jazzy")):
        thread = node.start()
        assert node.ready.wait(300)
        yield node
        node.close()
        thread.join(10)


def trajectory(joints, start, turn, seconds, first=0.0):
    """Of the first joint, by `turn` [rad]; begins where the arm is at time `first`."""

    def point(at, angle):
        positions = (start + angle * np.eye(len(start))[0]).tolist()
        return {"positions": positions, "time_from_start": {"sec": int(at), "nanosec": int(at % 1 * 1e9)}}

    return {"joint_names": joints, "points": [point(first, 0.0), point(seconds, turn)]}


def arm_state(peer, topic="rt/joint_states"):
    """Names and positions of the arm's joints, as the peer hears of them."""
    peer.drop(topic)
    peer.subscribe(topic, "JointState", depth=1)
    message = peer.take(topic, 1, timeout=20.0)[-1]
    pairs = [(n, p) for n, p in zip(message["name"], message["position"]) if "finger" not in n]
    return [n for n, _ in pairs], np.array([p for _, p in pairs])


def send(peer, number, goal, action=ARM):
    goal_id = {"uuid": [number] * 16}
    request = {"goal_id": goal_id, "goal": {"trajectory": goal}}
    answer = peer.call(f"{action}/_action/send_goal", "FollowSendGoal", request, timeout=20.0)
    return goal_id, answer["accepted"]


def result(peer, goal_id, action=ARM):
    return peer.call(f"{action}/_action/get_result", "FollowGetResult", {"goal_id": goal_id}, timeout=60.0)


def test_a_ros2_client_drives_the_arm(cell, peer):
    peer.subscribe(f"rt{ARM}/_action/feedback", "FollowFeedbackMessage", depth=0)
    peer.wait_matched(f"rt{ARM}/_action/feedback", timeout=20.0)
    joints, start = arm_state(peer)
    goal_id, accepted = send(peer, 1, trajectory(joints, start, 0.5, 2.0))
    assert accepted
    ended = result(peer, goal_id)
    assert (ended["status"], ended["result"]["error_code"]) == (4, 0)
    assert arm_state(peer)[1] - start == pytest.approx(0.5 * np.eye(7)[0], abs=0.01)
    told = peer.take(f"rt{ARM}/_action/feedback", 1)
    assert told and told[-1]["feedback"]["joint_names"] == joints
    assert len(told[-1]["feedback"]["actual"]["positions"]) == 7

    joints, start = arm_state(peer)
    goal_id, _ = send(peer, 2, trajectory(joints, start, -0.5, 20.0))
    time.sleep(1.0)
    answer = peer.call(CANCEL, "CancelGoal", {"goal_info": {"goal_id": goal_id}}, timeout=20.0)
    assert answer["return_code"] == 0
    ended = result(peer, goal_id)
    assert (ended["status"], ended["result"]["error_code"]) == (5, -1)
    assert "canceled by a client" in ended["result"]["error_string"]
    assert abs(arm_state(peer)[1][0] - start[0]) < 0.4  # it stopped on the way


def test_a_namespaced_and_remapped_cell(reach, peer):
    """As `armcell serve --ros2 --namespace arm_left --remap ...`; the peers come late."""
    bus, action, states = Bus(), "/follow", "rt/arm_left/joint_states"
    live = load("panda_pick").connect("fake", 0, time_scale=4.0)
    renamed = bus.with_remapping(name_map("armcell", "arm_left", [f"{ARM}:={action}"]))
    bridge = Ros2Bridge(bus, Ros2Settings(reach, "/arm_left/armcell", distro="jazzy"))
    with bridge, ServedCell(live, renamed):
        peer.subscribe("rt/arm_left/robot_description", "String", reliable=True, latched=True)
        assert "<robot" in peer.take("rt/arm_left/robot_description", 1, timeout=20.0)[0]["data"]
        joints, start = arm_state(peer, states)
        goal_id, accepted = send(peer, 1, trajectory(joints, start, 0.3, 1.0), action)
        assert accepted and result(peer, goal_id, action)["status"] == 4
        assert arm_state(peer, states)[1] - start == pytest.approx(0.3 * np.eye(7)[0], abs=0.01)
        with Ros2Bridge(there := Bus(), Ros2Settings(reach, "/late", distro="jazzy")) as late:
            assert late.wait_for_node("/arm_left/armcell", 5)
            tree = there.subscribe("/tf", "tf2_msgs/TFMessage", queue_size=20)  # without a namespace
            assert tree.get(20).transforms


@pytest.mark.long
def test_a_goal_that_a_newer_one_replaces_is_aborted_with_the_reason(cell, peer):
    joints, start = arm_state(peer)
    first, _ = send(peer, 30, trajectory(joints, start, 0.5, 20.0))
    time.sleep(1.0)
    joints, start = arm_state(peer)
    second, _ = send(peer, 31, trajectory(joints, start, 0.0, 0.5))
    ended = result(peer, first)
    assert (ended["status"], ended["result"]["error_code"]) == (6, -1)
    assert "preempted by a newer goal" in ended["result"]["error_string"]
    assert result(peer, second)["status"] in (4, 6)  # where the arm has come to rest decides


def test_wrong_trajectories_are_aborted_with_the_reason(cell, peer):
    joints, start = arm_state(peer)
    good = trajectory(joints, start, 0.1, 1.0)
    unknown = {**good, "joint_names": [*joints[:-1], "elbow"]}
    not_a_number = trajectory(joints, start, float("nan"), 1.0)
    elsewhere = trajectory(joints, start + 1.0, 0.1, 1.0)
    for number, (goal, reason) in enumerate(
        [(unknown, "unknown joint"), (not_a_number, "finite"), (elsewhere, "")], start=10
    ):
        goal_id, accepted = send(peer, number, goal)
        ended = result(peer, goal_id)
        assert accepted and ended["status"] == 6 and ended["result"]["error_code"] < 0, ended
        assert reason in ended["result"]["error_string"]
    goal_id, _ = send(peer, 20, good)
    assert result(peer, goal_id)["status"] == 4


def test_states_come_at_their_rate(cell, peer):
    """30 Hz of the cell's clock, which /clock shows; each message a step further."""
    peer.subscribe("rt/clock", "Clock", depth=0)
    clocks = [m["clock"] for m in peer.take("rt/clock", 60, timeout=20.0)]
    stamps = np.array([c["sec"] + c["nanosec"] * 1e-9 for c in clocks])
    assert len(stamps) >= 60 and (np.diff(stamps) > 0).all()
    assert np.median(np.diff(stamps)) == pytest.approx(1 / 30, abs=0.004)


def test_a_subscriber_that_has_stopped_holds_nobody_up(bus, bridge, peer, mortal):
    """Large messages, one of two readers frozen: the other one gets the last, writing never waits long."""
    for one in (peer, mortal):
        one.subscribe("rt/large", "String")
    publisher = bus.advertise("/large", "std_msgs/String")
    for one in (peer, mortal):
        one.wait_matched("rt/large", timeout=20.0)
    mortal.process.send_signal(signal.SIGSTOP)
    longest = 0.0
    for i in range(100):
        began = time.monotonic()
        publisher.publish(S.new("std_msgs/String", f"{i} " + "x" * 400_000))
        longest = max(longest, time.monotonic() - began)
        time.sleep(0.01)
    got, end = [], time.monotonic() + 20
    while "99" not in got and time.monotonic() < end:
        got += [m["data"].split()[0] for m in peer.take("rt/large", 1)]
    mortal.process.send_signal(signal.SIGCONT)
    assert got[-1] == "99" and longest < 2.0  # a reader's lease is 10 s


def start(environment, *arguments):
    return Program(
        [sys.executable, "-u", "-m", "armcell", *arguments],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env={**os.environ, **environment},
    )  # fmt: skip


@pytest.fixture
def patient(bus, reach):
    """The bus, joined to the domain; waits long for answers."""
    with Ros2Bridge(bus, Ros2Settings(reach, distro="jazzy", service_timeout=300.0)) as made:
        yield made


@pytest.mark.long
def test_simulator_and_planner_in_two_processes_grasp_over_dds(bus, patient, reach):
    """The first reference system's scenario: a Panda grasps a cube and lifts it."""
    environment = {"CYCLONEDDS_URI": reach.config, "ROS_DISTRO": "jazzy"}
    at = ("--ros2", "--domain", str(reach.domain))
    simulator = start(environment, "sim", "panda_table", *at, "--time-scale", "2")
    planner = start(environment, "serve", "panda_table", *at, "--plan-only")
    try:
        poses = bus.subscribe("/object_pose", "geometry_msgs/PoseStamped", queue_size=1)
        first = poses.get(300)
        assert first is not None
        assert bus.wait_for_service("/grasp", 300)
        assert patient.wait_for_node("/armcell", 10) and patient.wait_for_node("/armcell_sim", 10)
        answer = bus.call("/grasp", S.new("std_srvs/TriggerRequest"))
        assert answer.success, answer.message
        poses.get(5)
        assert poses.get(5).pose.position.z - first.pose.position.z > 0.15
    finally:
        said = []
        for process in (simulator, planner):
            process.send_signal(signal.SIGINT)
            said.append(process.communicate(timeout=60)[0])
    assert [p.returncode for p in (simulator, planner)] == [130, 130], said
    assert re.search(rf"ROS 2: node /armcell_sim \(domain {reach.domain}, LOCALHOST, jazzy\)", said[0])
    assert "/armcell_sim" in said[1]  # the status line names the other node
