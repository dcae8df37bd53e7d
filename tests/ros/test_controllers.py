"""Motions of `serve --plan-only` through the controllers of the robot's own program."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest
from tests.ros.helpers import remote_cell

from armcell.cell import Controller, load
from armcell.core import ErrorCode, InputError, JointState, JointTrajectory
from armcell.ros import ActionClient, ActionOutcome, ActionServer, Bus, GoalState, schema
from armcell.ros.convert import joint_state_message, trajectory_message
from armcell.ros.nodes import MoveGroupNode
from armcell.ros.nodes.external_controllers import select_controllers

S = schema()
FOLLOW, GRIP = "control_msgs/FollowJointTrajectory", "control_msgs/GripperCommand"
MODEL = load("dual_ur10").model
LEFT, RIGHT = (MODEL.group(f"{side}_arm").joint_names for side in ("left", "right"))


class Robot:
    """Joint states, and controllers that take the joints where they are sent, ten times as fast."""

    def __init__(self, cell="dual_ur10", controllers=()):
        self.bus, self.scene = Bus(), load(cell).scene()
        state = self.scene.state
        self.names, self.q = state.joint_names, state.positions.copy()
        self.goals, self.refuse, self.hang = [], {}, threading.Event()
        self.servers = []
        self.states = self.bus.advertise("/joint_states", "sensor_msgs/JointState")
        self.cell = remote_cell(self.bus, self.scene, controllers)
        self.stop = threading.Event()
        self.thread = threading.Thread(target=self.publish, daemon=True)

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *exc):
        self.stop.set()
        self.thread.join()
        self.cell.close()
        for server in self.servers:
            server.close()

    def publish(self):
        while not self.stop.wait(0.01):
            state = JointState(self.names, self.q.copy(), np.zeros(len(self.q)))
            self.states.publish(joint_state_message(S, self.bus.header(), state))

    def serve(self, name):
        self.servers.append(
            ActionServer(self.bus, f"/{name}/follow_joint_trajectory", FOLLOW, self.run(name))
        )

    def run(self, name):
        def follow(goal):
            wanted = goal.message.trajectory
            self.goals.append((name, wanted))
            if name in self.refuse:
                result = S.new(f"{FOLLOW}Result", *self.refuse[name])
                return ActionOutcome(GoalState.ABORTED, result, "aborted")
            while self.hang.is_set():
                if goal.cancel.wait(0.01):
                    return ActionOutcome(GoalState.PREEMPTED, S.new(f"{FOLLOW}Result"), "canceled")
            self.arrive(wanted)
            return ActionOutcome(GoalState.SUCCEEDED, S.new(f"{FOLLOW}Result"))

        return follow

    def arrive(self, wanted):
        time.sleep(wanted.points[-1].time_from_start.to_sec() / 10)
        for joint, position in zip(wanted.joint_names, wanted.points[-1].positions):
            self.q[self.names.index(joint)] = position

    def motion(self, joints, turn=0.1):
        q = self.scene.state.reindexed(joints).positions
        rows = np.array([q, q + turn])
        way = JointTrajectory(joints, np.array([0.0, 1.0]), rows, np.zeros_like(rows))
        return trajectory_message(S, self.bus.header(), way)


def arms():
    return tuple(
        Controller(f"{side}/jtc", "FollowJointTrajectory", f"/{side}/jtc/follow_joint_trajectory", joints)
        for side, joints in (("left", LEFT), ("right", RIGHT))
    )


@pytest.mark.slow
def test_a_motion_of_both_arms_is_divided_between_their_controllers():
    with Robot(controllers=arms()) as robot:
        robot.serve("left/jtc"), robot.serve("right/jtc")
        both = (*RIGHT, *LEFT)
        work = robot.cell.queue_trajectory(robot.motion(both))
        assert work.wait(20) and work.outcome().ok, work.outcome()
        goals = dict(robot.goals)
        assert [tuple(goals[n].joint_names) for n in ("left/jtc", "right/jtc")] == [LEFT, RIGHT]
        start = robot.scene.state
        for goal in goals.values():
            expected = start.reindexed(goal.joint_names).positions + 0.1
            assert list(goal.points[-1].positions) == pytest.approx(expected)
            assert goal.header.stamp.to_nsec() == 0  # at once
        assert robot.bus.topics() and not any(
            t.name == "/planned_trajectory" and t.subscribers for t in robot.bus.topics()
        )


@pytest.mark.long
def test_joints_that_a_motion_leaves_out_stay_where_they_are():
    """ros2_control's controllers refuse a goal that names a part of their joints."""
    with Robot(controllers=arms()) as robot:
        robot.serve("left/jtc"), robot.serve("right/jtc")
        work = robot.cell.queue_trajectory(robot.motion(LEFT[:2]))
        assert work.wait(20) and work.outcome().ok
        ((name, goal),) = robot.goals
        assert name == "left/jtc" and tuple(goal.joint_names) == LEFT
        rest = robot.scene.state.reindexed(LEFT[2:]).positions
        assert all(list(p.positions[2:]) == pytest.approx(rest) for p in goal.points)


@pytest.mark.slow
def test_a_failure_says_the_controllers_reason_and_stops_the_other_one():
    with Robot(controllers=arms()) as robot:
        robot.serve("left/jtc"), robot.serve("right/jtc")
        robot.hang.set()
        robot.refuse["right/jtc"] = (-4, "elbow off its path")
        work = robot.cell.queue_trajectory(robot.motion((*LEFT, *RIGHT)))
        assert work.wait(20)
        result = work.outcome()
        assert result.code is ErrorCode.CONTROL_FAILED
        assert result.message == "right/jtc: PATH_TOLERANCE_VIOLATED: elbow off its path"
        assert robot.q[robot.names.index(LEFT[0])] == robot.scene.state[LEFT[0]]  # never arrived


@pytest.mark.slow
def test_a_cancel_reaches_the_controllers():
    with Robot(controllers=arms()) as robot:
        robot.serve("left/jtc")
        robot.hang.set()
        work = robot.cell.queue_trajectory(robot.motion(LEFT))
        assert not work.wait(0.5)
        work.stop("stopped by a test")
        assert work.wait(5) and work.outcome().code is ErrorCode.PREEMPTED
        assert "stopped by a test" in work.outcome().message


@pytest.mark.slow
def test_a_controller_that_is_not_there_and_one_that_leaves():
    with Robot(controllers=arms()) as robot:
        with pytest.raises(InputError, match="left/jtc: no action server /left/jtc/follow_joint_trajectory"):
            robot.cell.queue_trajectory(robot.motion(LEFT))
        robot.serve("left/jtc")
        robot.hang.set()
        work = robot.cell.queue_trajectory(robot.motion(LEFT))
        assert not work.wait(0.5)
        server = robot.servers.pop()
        server._stop.set()
        for member in (*server._subs, *server._pub.values()):
            member.close()  # as a process that is killed
        assert work.wait(10) and work.outcome().message == "controller left/jtc has left"
        robot.hang.clear()


@pytest.mark.slow
def test_a_controller_by_topic_is_followed_by_the_joints():
    topic = Controller("left", "JointTrajectory", "/left/joint_trajectory", LEFT)
    with Robot(controllers=(topic,)) as robot:
        with pytest.raises(InputError, match="no subscriber of /left/joint_trajectory"):
            robot.cell.queue_trajectory(robot.motion(LEFT))
        got = robot.bus.subscribe("/left/joint_trajectory", "trajectory_msgs/JointTrajectory")
        work = robot.cell.queue_trajectory(robot.motion(LEFT))
        robot.arrive(got.get(5))
        assert work.wait(5) and work.outcome().ok and work.outcome().final_error < 0.01
        work = robot.cell.queue_trajectory(robot.motion(LEFT, 0.0))
        assert work.wait(5) and work.outcome().code is ErrorCode.CONTROL_FAILED
        assert "plan again" in work.outcome().message  # it is elsewhere by now


@pytest.mark.long
def test_a_canceled_motion_by_topic_is_held_where_it_is():
    topic = Controller("left", "JointTrajectory", "/left/joint_trajectory", LEFT)
    with Robot(controllers=(topic,)) as robot:
        got = robot.bus.subscribe("/left/joint_trajectory", "trajectory_msgs/JointTrajectory", queue_size=10)
        work = robot.cell.queue_trajectory(robot.motion(LEFT))
        assert len(got.get(5).points) == 2
        work.stop("enough")
        held = got.get(5)
        assert len(held.points) == 1 and list(held.points[0].velocities) == [0.0] * 6
        assert list(held.points[0].positions) == pytest.approx(robot.scene.state.reindexed(LEFT).positions)
        assert work.wait(10) and work.outcome().code is ErrorCode.PREEMPTED


def gripper_robot(**kind):
    hand = load("panda_pick").model.grippers["hand"]
    spec = Controller("hand", "GripperCommand", "/hand/gripper_cmd", (hand.joint_name,), **kind)
    return hand, Robot("panda_pick", (spec,))


@pytest.mark.slow
@pytest.mark.cases("kind0-*")
@pytest.mark.parametrize(("kind", "position"), [({}, 0.01), ({"gives_width": True}, 0.02)])
def test_a_gripper_is_driven_by_its_action(kind, position):
    hand, robot = gripper_robot(**kind)
    asked = []

    def grip(goal):
        asked.append((goal.message.command.position, goal.message.command.max_effort))
        robot.q[robot.names.index(hand.joint_name)] = 0.01
        return ActionOutcome(GoalState.SUCCEEDED, S.new(f"{GRIP}Result", 0.01, 5.0, False, True))

    with robot, ActionServer(robot.bus, "/hand/gripper_cmd", GRIP, grip):
        work = robot.cell.drive(hand, 0.02, 5.0)
        assert work.wait(10) and work.outcome().ok
        assert asked == [(pytest.approx(position), 5.0)]
        assert not work.outcome().evidence["stalled"]


@pytest.mark.slow
def test_a_gripper_that_fails_says_why():
    hand, robot = gripper_robot()
    refuse = lambda goal: ActionOutcome(GoalState.ABORTED, S.new(f"{GRIP}Result"), "no air pressure")  # noqa: E731
    with robot, ActionServer(robot.bus, "/hand/gripper_cmd", GRIP, refuse):
        work = robot.cell.drive(hand, 0.02, 5.0)
        assert work.wait(10) and work.outcome().code is ErrorCode.CONTROL_FAILED
        assert work.outcome().message == "hand: no air pressure"


@pytest.mark.slow
def test_fingers_of_a_trajectory_controller():
    hand = load("panda_pick").model.grippers["hand"]
    spec = Controller("hand", "FollowJointTrajectory", "/hand/follow_joint_trajectory", (hand.joint_name,))
    with Robot("panda_pick", (spec,)) as robot:
        robot.serve("hand")
        work = robot.cell.drive(hand, 0.02, 5.0)
        assert work.wait(10) and work.outcome().ok
        assert list(robot.goals[0][1].points[-1].positions) == [pytest.approx(0.01)]


@pytest.mark.slow
def test_clients_choose_controllers_by_name():
    """ExecuteTrajectory's `controller_names`, which only ROS 2 has."""
    with Robot(controllers=arms()) as robot, MoveGroupNode(robot.cell, robot.bus):
        robot.serve("left/jtc"), robot.serve("right/jtc")
        with ActionClient(robot.bus, "/execute_trajectory", "moveit_msgs/ExecuteTrajectory") as client:

            def execute(joints, *names):
                goal = S.new("moveit_msgs/ExecuteTrajectoryGoal", controller_names=list(names))
                goal.trajectory.joint_trajectory = robot.motion(joints)
                sent = client.send_goal(goal)
                assert sent.wait(30)
                return sent.result.error_code.val, sent.text

            code, text = execute(LEFT, "lift_jtc")
            assert code == -4 and "unknown controller 'lift_jtc'; known: left/jtc, right/jtc" in text
            code, text = execute(LEFT, "right/jtc")
            assert code == -4 and "no controller of right/jtc moves left_" in text
            assert not robot.goals
            assert execute(LEFT, "left/jtc")[0] == 1


def test_chosen():
    known = {"a": ("x", "y"), "b": ("z",)}
    assert select_controllers(known, (), ("z", "x")) == ["a", "b"]
    assert select_controllers(known, ("b",), ("z",)) == ["b"]
    with pytest.raises(InputError, match="no controller moves w"):
        select_controllers(known, (), ("w", "x"))
