"""Messages that are whole but make no sense: said once however often they come, and the good ones count."""

from __future__ import annotations

import logging
import threading

import numpy as np
import pytest
from tests.ros.tcp_helpers import wait_for

from armcell.cell import load
from armcell.core import InputError
from armcell.ros import ActionClient, Bus, schema
from armcell.ros.actions import GoalState
from armcell.ros.convert import unit_fault
from armcell.ros.faults import FaultCounter
from armcell.ros.nodes import RemoteDriver

S = schema()
STATES = "sensor_msgs/JointState"
FOLLOW = "control_msgs/FollowJointTrajectory"


@pytest.fixture(scope="module")
def scene():
    return load("panda_table").scene()


@pytest.fixture
def remote(scene):
    with RemoteDriver(Bus(), scene) as driver:
        yield driver


def states(scene, **changes):
    names, q = list(scene.model.joint_names), np.array(scene.positions)
    return S.new(STATES, **({"name": names, "position": q} | changes))


def test_joint_states_that_are_none(remote, scene, caplog):
    names, q = list(scene.model.joint_names), np.array(scene.positions)
    nan = np.where(np.arange(len(q)) == 2, np.nan, q)
    bad = [
        states(scene, position=nan), states(scene, velocity=nan), states(scene, position=q[:-1]),
        states(scene, position=np.rad2deg(q)), states(scene, name=[*names[:-1], "elbow"]),
        states(scene, name=[*names[:-1], names[0]]),
    ]  # fmt: skip
    publisher = remote._bus.advertise("/joint_states", STATES)
    publisher.publish(states(scene))
    wait_for(lambda: remote._joints is not None)
    with caplog.at_level(logging.WARNING):
        for _ in range(20):
            for message in bad:
                publisher.publish(message)
                wait_for(lambda: not remote._members[0]._queue)  # it holds two
        moved = states(scene, position=q + 0.01)
        publisher.publish(moved)
        wait_for(lambda: np.allclose(remote.joint_state().positions, q + 0.01))
    lines = [r.getMessage() for r in caplog.records if "/joint_states" in r.getMessage()]
    assert len(lines) == len(bad), lines
    for text in ("not finite", "names and", "look like degrees: ROS has radians", "'elbow'", "named twice"):
        assert any(text in line for line in lines), (text, lines)


def test_poses_that_are_none(remote, caplog):
    publisher = remote._bus.advertise("/object_pose/cube", "geometry_msgs/PoseStamped")
    bad = S.new("geometry_msgs/PoseStamped")
    bad.pose.orientation.w = float("nan")
    good = S.new("geometry_msgs/PoseStamped")
    good.pose.orientation.w, good.pose.position.x = 1.0, 0.25
    far = S.new("geometry_msgs/PoseStamped")
    far.pose.orientation.w, far.pose.position.x = 1.0, 503.0
    with caplog.at_level(logging.WARNING):
        for _ in range(5):
            for message in (bad, far):
                publisher.publish(message)
                wait_for(lambda: not remote._members[3]._queue)
        publisher.publish(good)
        wait_for(lambda: remote._poses)
    assert [p.translation[0] for p in remote._poses.values()] == [0.25]
    lines = [r.getMessage() for r in caplog.records if "pose of" in r.getMessage()]
    assert len(lines) == 2 and "503 m away (in millimeters?" in lines[1]


def test_a_simulator_that_only_sends_degrees_is_told_where_somebody_waits(remote, scene, monkeypatch):
    monkeypatch.setattr("armcell.ros.nodes.remote_driver.STATE_TIMEOUT", 0.3)
    publisher = remote._bus.advertise("/joint_states", STATES)
    publisher.publish(states(scene, position=np.rad2deg(scene.positions)))
    with pytest.raises(InputError, match="no /joint_states yet; the last one was refused.*degrees"):
        remote.wait_for_state()
        remote.joint_state()


@pytest.mark.parametrize("scale, fault", [(1.0, None), (1.2, None), (180 / np.pi, "degrees")])
def test_which_angles_look_like_degrees(scene, scale, fault):
    arm = [n for n in scene.model.joint_names if "finger" not in n]
    q = scale * scene.state.reindexed(arm).positions
    found = unit_fault(scene.model, arm, q.tolist())
    assert found is None if fault is None else fault in found


def test_which_lengths_look_like_millimeters(scene):
    finger = next(n for n in scene.model.joint_names if "finger" in n)
    assert unit_fault(scene.model, [finger], [0.03]) is None
    assert unit_fault(scene.model, [finger], [0.05]) is None  # beyond its limit, but not by a thousand
    assert "millimeters" in unit_fault(scene.model, [finger], [30.0])


def test_time_may_go_back(remote):
    """A simulator was started again: its clock begins anew, and stamps follow."""
    bus = remote._bus
    publisher = bus.advertise("/clock", "rosgraph_msgs/Clock")
    for seconds in (100, 3):
        publisher.publish(S.new("rosgraph_msgs/Clock", S.new("builtin_interfaces/Time", seconds, 0)))
        wait_for(lambda seconds=seconds: bus.clock.now() == seconds)
    assert bus.header().stamp.sec == 3
    assert not bus.clock.wait_until(50.0, timeout=0.01) and bus.clock.wait_until(2.0, timeout=0.01)


def test_a_result_in_no_known_state_ends_the_goal_all_the_same(caplog):
    bus = Bus()
    goals = bus.subscribe("/arm/goal", f"{FOLLOW}ActionGoal")
    result = bus.advertise("/arm/result", f"{FOLLOW}ActionResult")
    status = bus.advertise("/arm/status", "actionlib_msgs/GoalStatusArray")
    with ActionClient(bus, "/arm", FOLLOW) as client, caplog.at_level(logging.ERROR):
        sent = client.send_goal(S.new(f"{FOLLOW}Goal"))
        odd = S.new("actionlib_msgs/GoalStatus", goals.get(5).goal_id, 77)
        status.publish(S.new("actionlib_msgs/GoalStatusArray", status_list=[odd]))
        assert not sent.wait(0.05) and sent.state is GoalState.PENDING
        result.publish(S.new(f"{FOLLOW}ActionResult", status=odd))
        assert sent.wait(5) and sent.state is GoalState.LOST and sent.state.is_terminal
    assert not caplog.records


def test_complaints_are_counted_by_many_and_said_by_kind():
    complaints, said = FaultCounter(most=10), []

    def complain(who):
        for i in range(200):
            if complaints.count(f"kind {i % 20}"):
                said.append(who)

    threads = [threading.Thread(target=complain, args=(i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert complaints.total == 800 and len(said) == 11  # ten kinds, and one for all the others
