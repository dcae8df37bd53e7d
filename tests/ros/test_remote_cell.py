"""A cell whose simulator is elsewhere: which of its motions run, and how their ends are known."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest
from tests.ros.helpers import remote_cell
from tests.ros.tcp_helpers import wait_for

from armcell.cell import load
from armcell.core import SE3, ErrorCode, JointTrajectory
from armcell.ros import ActionClient, Bus, GoalState, schema
from armcell.ros.convert import joint_state_message, pose_message, trajectory_message
from armcell.ros.nodes import MoveGroupNode, PickPlaceNode
from armcell.ros.nodes.scene_node import SceneNode

S = schema()


class Simulator:
    """Stands at the cell's first state, and says what a test lets it say."""

    def __init__(self, name):
        self.bus, self.scene = Bus(), load(name).scene()
        self.cell = remote_cell(self.bus, self.scene)
        self.got = self.bus.subscribe("/planned_trajectory", "trajectory_msgs/JointTrajectory", queue_size=50)
        self.status = self.bus.advertise("/trajectory_status", "std_msgs/String")
        self.states = self.bus.advertise("/joint_states", "sensor_msgs/JointState")
        self.stop = threading.Event()
        self.thread = threading.Thread(target=self.publish, daemon=True)

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *exc):
        self.stop.set()
        self.thread.join()
        self.cell.close()

    def publish(self):
        while not self.stop.wait(0.02):
            self.states.publish(joint_state_message(S, self.bus.header(), self.scene.state))

    def say(self, *texts):
        for text in texts:
            self.status.publish(S.new("std_msgs/String", text))

    def motion(self, group):
        names = self.scene.model.group(group).joint_names
        q = self.scene.state.reindexed(names).positions
        way = JointTrajectory(names, np.array([0.0, 1.0]), np.array([q, q + 0.1]))
        return trajectory_message(S, self.bus.header(), way)


@pytest.mark.slow
def test_what_was_said_of_an_earlier_motion_ends_no_later_one():
    with Simulator("panda_table") as sim:
        first = sim.cell.queue_trajectory(sim.motion("panda_arm"))
        assert sim.got.get(5).points
        sim.say("executing 2 points, 1.00 s")
        second = sim.cell.queue_trajectory(sim.motion("panda_arm"))  # takes over
        assert first.outcome().code is ErrorCode.PREEMPTED
        assert not sim.got.get(5).points and sim.got.get(5).points  # a stop, then the motion
        sim.say("stopped: cancelled at 0.10 of 1.00 s", "stop", "done: empty trajectory: stopped")
        assert not second.wait(0.2)
        sim.say("executing 2 points, 1.00 s")
        assert not second.wait(0.1)
        sim.say("done: final error 0.0001")
        assert second.wait(5) and second.outcome().ok
        third = sim.cell.queue_trajectory(sim.motion("panda_arm"))
        sim.got.get(5)
        sim.say("refused: unknown joint")
        assert third.wait(5) and "unknown joint" in third.outcome().message


@pytest.mark.slow
def test_a_simulator_that_says_only_how_a_motion_ended():
    with Simulator("panda_table") as sim:
        work = sim.cell.queue_trajectory(sim.motion("panda_arm"))
        assert sim.got.get(5).points
        sim.say("done: arrived")
        assert work.wait(2) and work.outcome().ok


@pytest.mark.slow
def test_the_second_arm_waits_for_the_first():
    """What is said does not tell which motion is meant, and nothing proves that two would not meet."""
    with Simulator("dual_ur10") as sim:
        left, begun = sim.cell.queue_trajectory(sim.motion("left_arm")), []
        assert sim.got.get(5).points
        other = threading.Thread(
            target=lambda: begun.append(sim.cell.queue_trajectory(sim.motion("right_arm")))
        )
        other.start()
        sim.say("executing 2 points, 1.00 s")
        assert sim.got.get(0.3) is None and not begun
        sim.say("done: final error 0.0001")
        assert left.wait(5) and left.outcome().ok
        other.join(5)
        assert sim.got.get(5).joint_names[0].startswith("right_")
        sim.say("executing 2 points, 1.00 s", "failed: left the path")
        assert begun[0].wait(5) and begun[0].outcome().code is ErrorCode.CONTROL_FAILED


@pytest.mark.slow
def test_a_motion_that_begins_elsewhere_is_refused_and_a_stop_stops_every_joint():
    with Simulator("panda_table") as sim:
        away = sim.motion("panda_arm")
        away.points[0].positions = away.points[0].positions + 0.5
        work = sim.cell.queue_trajectory(away)
        assert work.wait(5) and work.outcome().code is ErrorCode.CONTROL_FAILED
        assert "from the trajectory's start" in work.outcome().message
        running = sim.cell.queue_trajectory(sim.motion("panda_arm"))
        assert sim.cell.queue_trajectory(S.new("trajectory_msgs/JointTrajectory")).wait(5)
        assert running.outcome().code is ErrorCode.PREEMPTED


@pytest.mark.slow
def test_things_are_where_the_simulator_says_even_if_it_says_so_a_little_late(caplog):
    with Simulator("panda_table") as sim:
        pose = sim.bus.advertise("/object_pose", "geometry_msgs/PoseStamped")
        T = SE3.from_xyz(0.5, -0.2, 0.1)
        wait_for(lambda: sim.cell.live.driver.has_joint_states)
        later = threading.Timer(
            0.3,
            lambda: pose.publish(
                S.new("geometry_msgs/PoseStamped", sim.bus.header("world"), pose_message(S, T))
            ),
        )
        later.start()
        assert sim.cell.scene().object("cube").T_world_object.isclose(T)
    with Simulator(
        "panda_table"
    ) as sim:  # one that says nothing of objects: they are where the cell has them
        cube = sim.cell.scene().object("cube")
        assert cube.T_world_object.isclose(sim.scene.object("cube").T_world_object)
        sim.cell.scene()
        assert caplog.text.count("no /object_pose of") == 1  # waited for but once


@pytest.mark.slow
def test_the_whole_scene_is_told_once_the_simulator_is_there(monkeypatch):
    monkeypatch.setattr("armcell.ros.nodes.remote_driver.STATE_TIMEOUT", 0.1)
    sim = Simulator("panda_table")
    node = SceneNode(sim.cell, sim.bus)
    try:
        time.sleep(0.5)  # nobody is there yet
        told = sim.bus.subscribe("/monitored_planning_scene", "moveit_msgs/PlanningScene", queue_size=50)
        with sim:
            first = told.get(5)
            assert not first.is_diff and "table" in [o.id for o in first.world.collision_objects]
    finally:
        node.close()


@pytest.mark.slow
def test_without_a_simulator_every_action_ends_with_a_code_and_the_reason(monkeypatch, caplog):
    monkeypatch.setattr("armcell.ros.nodes.remote_driver.STATE_TIMEOUT", 0.05)
    sim = Simulator("panda_table")
    bus = sim.bus
    group = MoveGroupNode(sim.cell, bus)
    pick = PickPlaceNode(group)
    trajectory = S.new("moveit_msgs/RobotTrajectory", sim.motion("panda_arm"))
    goals = {
        "MoveGroup": ("/move_group", {}),
        "ExecuteTrajectory": ("/execute_trajectory", {"trajectory": trajectory}),
        "Pickup": ("/pickup", {"target_name": "cube"}),
        "Place": ("/place", {}),
    }
    try:
        for kind, (action, fields) in goals.items():
            with ActionClient(bus, action, f"moveit_msgs/{kind}") as client:
                sent = client.send_goal(S.new(f"moveit_msgs/{kind}Goal", **fields))
                assert sent.wait(5) and sent.state is GoalState.ABORTED and "/joint_states" in sent.text
                assert sent.result.error_code.val in (99999, -4), kind
    finally:
        pick.close()
        group.close()
        sim.cell.close()
    assert not [r for r in caplog.records if r.exc_info]


@pytest.mark.slow
def test_a_trajectory_of_the_fingers_alone_is_a_gripper_command():
    """The simulator stops the fingers at the object, so the motion gate must not refuse their way there."""
    with Simulator("panda_table") as sim:
        commands = sim.bus.subscribe("/gripper_command", "std_msgs/Float64")
        hand = sim.scene.model.gripper("hand")
        names, q = (hand.joint_name,), sim.scene.state.reindexed((hand.joint_name,)).positions
        closing = JointTrajectory(names, np.array([0.0, 1.0]), np.array([q, [0.01]]))
        work = sim.cell.queue_trajectory(trajectory_message(S, sim.bus.header(), closing))
        assert commands.get(2.0).data == pytest.approx(hand.width(0.01))
        assert work.wait(10.0) and work.outcome().ok and work.outcome().evidence["stalled"]
        assert sim.got.get(0.1) is None
