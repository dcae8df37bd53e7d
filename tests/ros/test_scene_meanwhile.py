"""The planning scene changed over the bus while the arm moves: by every door, in every action."""

from __future__ import annotations

import time

import numpy as np
import pytest

from armcell.cell import load
from armcell.core import SE3, ErrorCode
from armcell.ros import ActionClient, Bus, GoalState, schema
from armcell.ros.convert import pose_message
from armcell.ros.nodes import ServedCell, ServedPlanner

S = schema()
CHANGED = int(ErrorCode.MOTION_PLAN_INVALIDATED_BY_ENVIRONMENT_CHANGE)
ACROSS, BESIDE = SE3.from_xyz(0.16, 0.27, 0.6), SE3.from_xyz(-0.6, 0.0, 0.6)
ADD, REMOVE = 0, 1


def new(name, *values, **fields):
    return S.new(f"moveit_msgs/{name}", *values, **fields)


@pytest.fixture(scope="module")
def served():
    with ServedCell(load("panda_pick").connect("fake", None, time_scale=4.0), Bus()) as cell:
        yield cell


@pytest.fixture
def bus(served):
    """The bus, with the arm at home and the world as it was."""
    scene = served.live.scene_at_start
    served.cell.edit_scene(lambda now: scene.with_positions(now.positions))
    assert move(served.bus, 0.0, velocity=0.5)[0] is GoalState.SUCCEEDED
    return served.bus


def asked(value, velocity=0.1):
    joint = new("JointConstraint", "panda_joint1", float(value), 1e-4, 1e-4, 1.0)
    home = load("panda_pick").scene().model.named_states["arm"]["home"]
    others = [new("JointConstraint", n, float(v), 1e-4, 1e-4, 1.0) for n, v in home.items() if n[-1] != "1"]
    request = new(
        "MotionPlanRequest", group_name="arm", allowed_planning_time=5.0,
        goal_constraints=[new("Constraints", joint_constraints=[joint, *others])],
        max_velocity_scaling_factor=velocity, max_acceleration_scaling_factor=0.5,
    )  # fmt: skip
    request.start_state.is_diff = True
    return request


def move(bus, value, meanwhile=None, velocity=0.1, replan=False, plan_only=False):
    goal = new("MoveGroupGoal", asked(value, velocity))
    options = goal.planning_options
    options.planning_scene_diff.is_diff, options.plan_only = True, plan_only
    options.replan, options.replan_attempts = replan, 3
    return ended(bus, "/move_group", "MoveGroup", goal, meanwhile)


def ended(bus, name, kind, goal, meanwhile=None, after=0.3):
    """Send a goal; once the arm has moved for a while do something; the goal's state and code."""
    states = bus.subscribe("/joint_states", "sensor_msgs/JointState", queue_size=1)
    with ActionClient(bus, name, f"moveit_msgs/{kind}") as client:
        sent = client.send_goal(goal)
        if meanwhile is not None:
            moving = 0
            while moving < 3 and not sent.wait(0.0):
                speeds = dict(zip((m := states.get(5)).name, m.velocity))
                moving += max(abs(v) for n, v in speeds.items() if "finger" not in n) > 0.05
            assert not sent.wait(after)
            meanwhile()
        assert sent.wait(60)
        return sent.state, sent.result.error_code.val, sent.result


def rod(pose=ACROSS, operation=ADD):
    item = new("CollisionObject", id="rod", operation=operation)
    item.primitives, item.pose = (
        [S.new("shape_msgs/SolidPrimitive", 1, [0.06, 0.06, 0.5])],
        pose_message(S, pose),
    )
    return item


def by_topic(bus, item):
    bus.advertise("/collision_object", "moveit_msgs/CollisionObject").publish(item)


def by_scene(bus, item):
    diff = new("PlanningScene", is_diff=True)
    diff.world.collision_objects = [item]
    bus.advertise("/planning_scene", "moveit_msgs/PlanningScene").publish(diff)


def by_service(bus, item):
    diff = new("PlanningScene", is_diff=True)
    diff.world.collision_objects = [item]
    assert bus.call("/apply_planning_scene", new("ApplyPlanningSceneRequest", diff)).success


DOORS = {"/collision_object": by_topic, "/planning_scene": by_scene, "apply_planning_scene": by_service}


@pytest.mark.slow
@pytest.mark.cases("/planning_scene", "/collision_object")
@pytest.mark.parametrize(
    "door", [pytest.param(name, marks=[pytest.mark.slow] if i else []) for i, name in enumerate(DOORS)]
)
def test_execute_trajectory_stops_before_what_comes_through_every_door(bus, served, door):
    planned = move(bus, 1.9, plan_only=True)[2].planned_trajectory
    status = bus.subscribe("/trajectory_status", "std_msgs/String", queue_size=20)
    goal = new("ExecuteTrajectoryGoal", planned)
    state, code, _ = ended(
        bus, "/execute_trajectory", "ExecuteTrajectory", goal, lambda: DOORS[door](bus, rod())
    )
    assert (state, code) == (GoalState.ABORTED, CHANGED)
    said = [m.data for m in iter(lambda: status.get(0.2), None)]
    assert any("would touch rod" in text for text in said), said
    at = served.cell.scene().state["panda_joint1"]
    assert 0.01 < at < 1.0 and "rod" in served.cell.scene().objects
    assert move(bus, 1.9, velocity=0.5)[:2] == (GoalState.SUCCEEDED, 1)  # around it
    DOORS[door](bus, rod(operation=REMOVE))
    give_up = time.monotonic() + 5
    while "rod" in served.cell.scene().objects and time.monotonic() < give_up:
        time.sleep(0.01)
    assert "rod" not in served.cell.scene().objects


@pytest.mark.slow
def test_what_comes_beside_the_way_stops_nothing(bus):
    planned = move(bus, 1.0, plan_only=True, velocity=0.2)[2].planned_trajectory
    goal = new("ExecuteTrajectoryGoal", planned)
    done = ended(
        bus, "/execute_trajectory", "ExecuteTrajectory", goal, lambda: by_service(bus, rod(BESIDE)), 0.05
    )
    assert done[:2] == (GoalState.SUCCEEDED, 1)


@pytest.mark.slow
def test_move_group_says_so_or_plans_again(bus, served):
    assert move(bus, 1.9, lambda: by_topic(bus, rod()))[:2] == (GoalState.ABORTED, CHANGED)
    by_service(bus, rod(operation=REMOVE))
    assert move(bus, 0.0, velocity=0.5)[:2] == (GoalState.SUCCEEDED, 1)
    done = move(bus, 1.9, lambda: by_topic(bus, rod()), replan=True)
    assert done[:2] == (GoalState.SUCCEEDED, 1)
    assert served.cell.scene().state["panda_joint1"] == pytest.approx(1.9, abs=0.01)


@pytest.mark.slow
def test_pickup_goes_around(bus, served):
    scene = served.cell.scene()
    cube = scene.object("cube").T_world_object.translation
    hand = scene.frame_pose("panda_hand").translation
    between = (cube + hand) / 2 + [0.0, 0.0, 0.1]
    goal = new("PickupGoal", target_name="cube", group_name="arm", allowed_planning_time=10.0)
    goal.planning_options.planning_scene_diff.is_diff = True
    thing = rod(SE3.from_xyz(*between))
    thing.primitives[0].dimensions = [0.04, 0.04, 0.04]
    before = len(served.live.ctx.events)
    state, code, _ = ended(bus, "/pickup", "Pickup", goal, lambda: by_topic(bus, thing), 0.0)
    assert [e.data["object"] for e in served.live.ctx.events[before:] if e.kind == "stop"] == ["rod"]
    assert (state, code) == (GoalState.SUCCEEDED, 1)
    assert set(served.cell.scene().attached) == {"cube"} and "rod" in served.cell.scene().objects


@pytest.mark.slow
def test_a_planner_far_from_the_robot_stops_it_too():
    bus = Bus()
    cell = load("panda_pick")
    live = cell.connect("fake", None, time_scale=4.0)
    with ServedCell(live, bus, plan=False) as robot, ServedPlanner(cell, bus):
        assert move(bus, 1.9, lambda: by_topic(bus, rod()))[:2] == (GoalState.ABORTED, CHANGED)
        stopped = robot.live.scene().state["panda_joint1"]
        assert 0.01 < stopped < 1.0
        assert move(bus, 1.9, velocity=0.5)[:2] == (GoalState.SUCCEEDED, 1)
        q = robot.live.scene().state.positions
        assert np.isfinite(q).all()
