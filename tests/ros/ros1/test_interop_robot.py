"""`serve --plan-only` drives a robot of a real ROS 1 graph, whose action Debian's actionlib serves."""

from __future__ import annotations

import json

import numpy as np
import pytest
from tests.ros.ros1.conftest import eventually
from tests.ros.ros1.debian import Debian, missing

from armcell.cell import load
from armcell.ros import ActionClient, Bus, GoalState, schema
from armcell.ros.nodes import ServedPlanner
from armcell.ros.ros1 import Ros1Graph, Ros1Settings

pytestmark = [pytest.mark.interop, pytest.mark.slow]
S = schema()
CELL = """
robot: ur10
start: {arm: home}
controllers:
  pos_joint_traj_controller: {}
"""

# As ros_control's joint_trajectory_controller: in namespace /lab, all joints in every goal, straight lines.
ROBOT = """
import sys; sys.path.insert(0, ".")
import actionlib, json, ours, rospy, threading, time
from sensor_msgs.msg import JointState
rospy.init_node("robot")
names, start = json.loads(sys.argv[1])
q = dict(zip(names, start))
ours.message("control_msgs/FollowJointTrajectoryAction")
Result = ours.MADE["control_msgs/FollowJointTrajectoryResult"]
states = rospy.Publisher("/lab/joint_states", JointState, queue_size=1)
def publish(event):
    state = JointState(name=names, position=[q[n] for n in names], velocity=[0.0] * len(names))
    state.header.stamp = rospy.Time.now()
    states.publish(state)
rospy.Timer(rospy.Duration(0.02), publish)
def follow(goal):
    if set(goal.trajectory.joint_names) != set(names):
        server.set_aborted(Result(-2, "joints: " + ", ".join(goal.trajectory.joint_names)))
        return
    last = goal.trajectory.points[-1]
    print(json.dumps(len(goal.trajectory.points)), flush=True)
    first, began, seconds = dict(q), time.time(), last.time_from_start.to_sec()
    if abs(last.positions[0] - first[goal.trajectory.joint_names[0]]) > 1.0:
        server.set_aborted(Result(-4, "the elbow left its path"))
        return
    while time.time() - began < seconds:
        if server.is_preempt_requested():
            server.set_preempted(Result(0, ""))
            return
        for n, end in zip(goal.trajectory.joint_names, last.positions):
            q[n] = first[n] + (end - first[n]) * min((time.time() - began) / seconds, 1.0)
        time.sleep(0.01)
    q.update(zip(goal.trajectory.joint_names, last.positions))
    server.set_succeeded(Result(0, ""))
server = actionlib.SimpleActionServer(
    "/lab/pos_joint_traj_controller/follow_joint_trajectory",
    ours.MADE["control_msgs/FollowJointTrajectoryAction"], follow, auto_start=False,
)
server.start()
rospy.spin()
"""


@pytest.fixture
def planner(tmp_path):
    if why := missing():
        pytest.skip(f"no real ROS 1: {why}")
    debian = Debian(tmp_path)
    (tmp_path / "cell.yaml").write_text(CELL)
    cell, bus = load(tmp_path), Bus()
    start = cell.scene().state
    try:
        debian.start_master()
        joints = json.dumps([list(start.joint_names), start.positions.tolist()])
        debian.start_rospy(ROBOT, joints)
        settings = Ros1Settings(name="armcell", namespace="/lab", master=debian.uri, own_master=False)
        with ServedPlanner(cell, bus) as served:
            graph = Ros1Graph(bus, settings)
            graph.start()
            try:
                yield served
            finally:
                graph.close()
    finally:
        debian.close()


def move(served, turn, cancel=False):
    """A move_group goal of the first joint, by `turn` [rad] from where it is."""
    state = served.cell.scene().state
    values = dict(zip(state.joint_names, state.positions + turn * np.eye(6)[0]))
    new = lambda name, *v, **f: S.new(f"moveit_msgs/{name}", *v, **f)  # noqa: E731
    joints = [new("JointConstraint", n, float(v), 1e-4, 1e-4, 1.0) for n, v in values.items()]
    goal = new("MoveGroupGoal")
    goal.request.group_name = "arm"
    goal.request.goal_constraints = [new("Constraints", joint_constraints=joints)]
    goal.request.max_velocity_scaling_factor = 0.05 if cancel else 1.0
    goal.planning_options.planning_scene_diff.is_diff = True
    with ActionClient(served.bus, "/move_group", "moveit_msgs/MoveGroup") as client:
        sent = client.send_goal(goal)
        if cancel:
            assert not sent.wait(2.0)
            sent.cancel()
        assert sent.wait(120)
        return sent


def test_a_plan_drives_the_robots_action_in_its_namespace(planner):
    start = planner.cell.scene().state.positions
    done = move(planner, 0.3)
    assert done.state is GoalState.SUCCEEDED, done.text
    end = start + 0.3 * np.eye(6)[0]
    eventually(
        lambda: np.allclose(planner.cell.scene().state.positions, end, atol=1e-3)
    )  # states come at 50 Hz
    done = move(planner, -0.9, cancel=True)
    assert done.state is GoalState.PREEMPTED
    assert start[0] - 0.6 < planner.cell.scene().state.positions[0] < start[0] + 0.3  # on the way
    done = move(planner, 1.5)
    assert done.state is GoalState.ABORTED
    assert "PATH_TOLERANCE_VIOLATED: the elbow left its path" in done.result.error_code.message
