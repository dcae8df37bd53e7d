"""`serve --plan-only` drives a robot that serves a FollowJointTrajectory action over DDS."""

import numpy as np
import pytest
from tests.ros.ros1.conftest import eventually

from armcell.cell import load
from armcell.ros import ActionClient, Bus, GoalState, Ros2Bridge, Ros2Settings, schema
from armcell.ros.nodes import ServedPlanner

pytestmark = pytest.mark.slow
S = schema()
CELL = """
robot: ur10
start: {arm: home}
controllers:
  lab/scaled_joint_trajectory_controller: {}
"""
ACTION = "/lab/scaled_joint_trajectory_controller/follow_joint_trajectory"


@pytest.fixture
def planner(reach, peer, tmp_path):
    """The planner of a UR10, whose driver is the peer."""
    (tmp_path / "cell.yaml").write_text(CELL)
    cell = load(tmp_path)
    start = cell.scene().state
    peer.serve_arm(ACTION, list(start.joint_names), start.positions.tolist())
    bus = Bus()
    with Ros2Bridge(bus, Ros2Settings(reach, distro="jazzy")), ServedPlanner(cell, bus) as served:
        yield served


def move(served, turn, scaling=1.0, cancel=False):
    """A move_group goal of the first joint, by `turn` [rad] from where it is."""
    group = served.cell.model.group("arm")
    state = served.cell.scene().state.reindexed(group.joint_names)
    values = dict(zip(state.joint_names, state.positions + turn * np.eye(len(state.joint_names))[0]))
    new = lambda name, *v, **f: S.new(f"moveit_msgs/{name}", *v, **f)  # noqa: E731
    joints = [new("JointConstraint", n, float(v), 1e-4, 1e-4, 1.0) for n, v in values.items()]
    goal = new("MoveGroupGoal")
    goal.request.group_name = "arm"
    goal.request.goal_constraints = [new("Constraints", joint_constraints=joints)]
    goal.request.max_velocity_scaling_factor = goal.request.max_acceleration_scaling_factor = scaling
    goal.planning_options.planning_scene_diff.is_diff = True
    with ActionClient(served.bus, "/move_group", "moveit_msgs/MoveGroup") as client:
        begun = client.send_goal(goal)
        if cancel:
            assert not begun.wait(2.0)
            begun.cancel()
        assert begun.wait(120)
        return begun


def test_a_plan_drives_the_robots_action_and_a_cancel_reaches_it(planner, peer):
    start = planner.cell.scene().state
    done = move(planner, 0.3)
    assert done.state is GoalState.SUCCEEDED, done.text
    joints, points = peer.goals_taken()[0]
    assert joints == list(start.joint_names) and points >= 2
    end = start.positions + 0.3 * np.eye(6)[0]
    eventually(
        lambda: np.allclose(planner.cell.scene().state.positions, end, atol=1e-3)
    )  # states come at 50 Hz
    done = move(planner, -1.5, scaling=0.05, cancel=True)
    assert done.state is GoalState.PREEMPTED and done.result.error_code.val == -7
    now = planner.cell.scene().state.positions[0]
    assert start.positions[0] + 0.3 - 1.0 < now < start.positions[0] + 0.3  # on the way
    assert len(peer.goals_taken()) == 2
