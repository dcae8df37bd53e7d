"""move_group on the bus: services, actions and codes as clients of the real one get them."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from armcell.cell import load
from armcell.core import SE3, SO3
from armcell.ros import ActionClient, Bus, GoalState, schema
from armcell.ros.convert import pose_from_message, pose_message
from armcell.ros.nodes import ServedCell

S = schema()


def new(name, *values, **fields):
    return S.new(f"moveit_msgs/{name}", *values, **fields)


@pytest.fixture(scope="module")
def served():
    with ServedCell(load("panda_pick").connect("fake", None, time_scale=20.0), Bus()) as cell:
        yield cell


@pytest.fixture
def bus(served):
    """The bus, with the arm at home and the world as it was."""
    move(served.bus, joint_goal(dict(served.live.model.named_states["arm"]["home"])))
    scene = served.live.scene_at_start
    served.cell.edit_scene(lambda now: scene.with_positions(now.positions))
    return served.bus


def joint_goal(values, tolerance=1e-4):
    joints = [new("JointConstraint", n, float(v), tolerance, tolerance, 1.0) for n, v in values.items()]
    return new("Constraints", joint_constraints=joints)


def request(*goals, group="arm", **fields):
    asked = new(
        "MotionPlanRequest", group_name=group, goal_constraints=list(goals), allowed_planning_time=5.0
    )
    for name, value in fields.items():
        setattr(asked, name, value)
    asked.start_state.is_diff = True
    return asked


def move(bus, *goals, plan_only=False, scene_diff=None, feedback=None, cancel_after=None, **fields):
    """Send a move_group goal and wait: (state, result, text)."""
    goal = new("MoveGroupGoal", request(*goals, **fields))
    goal.planning_options.plan_only = plan_only
    goal.planning_options.planning_scene_diff = scene_diff or new("PlanningScene", is_diff=True)
    with ActionClient(bus, "/move_group", "moveit_msgs/MoveGroup") as client:
        sent = client.send_goal(goal, feedback)
        if cancel_after is not None:
            time.sleep(cancel_after)
            sent.cancel()
        assert sent.wait(60)
        return sent.state, sent.result, sent.text


def ik(bus, xyz=(0.5, 0.1, 0.4), group="arm", **fields):
    asked = new("PositionIKRequest", group_name=group, avoid_collisions=True, **fields)
    turned = S.new("geometry_msgs/Quaternion", x=1.0)
    asked.pose_stamped.pose = S.new("geometry_msgs/Pose", S.new("geometry_msgs/Point", *xyz), turned)
    return bus.call("/compute_ik", new("GetPositionIKRequest", asked))


def arm(served):
    names = served.live.model.group("arm").joint_names
    return served.cell.scene().state.reindexed(names).positions


# --- what there is ---
SERVED = {  # of a running move_group (Noetic, Panda), but load_map and save_map, which need an octomap server
    "/apply_planning_scene": "moveit_msgs/ApplyPlanningScene",
    "/check_state_validity": "moveit_msgs/GetStateValidity",
    "/clear_octomap": "std_srvs/Empty",
    "/compute_cartesian_path": "moveit_msgs/GetCartesianPath",
    "/compute_fk": "moveit_msgs/GetPositionFK",
    "/compute_ik": "moveit_msgs/GetPositionIK",
    "/get_planner_params": "moveit_msgs/GetPlannerParams",
    "/get_planning_scene": "moveit_msgs/GetPlanningScene",
    "/plan_kinematic_path": "moveit_msgs/GetMotionPlan",
    "/query_planner_interface": "moveit_msgs/QueryPlannerInterfaces",
    "/set_planner_params": "moveit_msgs/SetPlannerParams",
}
HEARD = {
    "/attached_collision_object": "moveit_msgs/AttachedCollisionObject",
    "/collision_object": "moveit_msgs/CollisionObject",
    "/planning_scene": "moveit_msgs/PlanningScene",
    "/planning_scene_world": "moveit_msgs/PlanningSceneWorld",
    "/trajectory_execution_event": "std_msgs/String",
}
TOLD = {
    "/joint_states": "sensor_msgs/JointState",
    "/move_group/display_planned_path": "moveit_msgs/DisplayTrajectory",
    "/move_group/monitored_planning_scene": "moveit_msgs/PlanningScene",
    "/tf": "tf2_msgs/TFMessage",
}
ACTIONS = {
    "/execute_trajectory": "ExecuteTrajectory", "/move_group": "MoveGroup",
    "/pickup": "Pickup", "/place": "Place",
}  # fmt: skip


def test_what_real_clients_look_for_is_there(served):
    topics = {t.name: t for t in served.bus.topics()}
    services = served.bus.services()
    assert {n: services.get(n) for n in SERVED} == SERVED
    heard, told = dict(HEARD), dict(TOLD)
    for name, kind in ACTIONS.items():
        heard |= {f"{name}/goal": f"moveit_msgs/{kind}ActionGoal", f"{name}/cancel": "actionlib_msgs/GoalID"}
        told |= {f"{name}/{p}": f"moveit_msgs/{kind}Action{p.capitalize()}" for p in ("result", "feedback")}
        told[f"{name}/status"] = "actionlib_msgs/GoalStatusArray"
    assert {n: topics[n].type for n in heard if topics[n].subscribers} == heard
    assert {n: topics[n].type for n in told if topics[n].publishers} == told


# --- kinematics ---
def test_ik_then_fk_gives_the_pose_back(bus):
    found = ik(bus)
    assert found.error_code.val == 1
    asked = new(
        "GetPositionFKRequest", fk_link_names=["panda_hand_tcp", "panda_link0"], robot_state=found.solution
    )
    answer = bus.call("/compute_fk", asked)
    T = pose_from_message(answer.pose_stamped[0].pose)
    assert answer.error_code.val == 1 and answer.fk_link_names == ["panda_hand_tcp", "panda_link0"]
    assert np.allclose(T.translation, (0.5, 0.1, 0.4), atol=1e-5)
    assert np.allclose(T.rotation.matrix, np.diag([1, -1, -1]), atol=1e-5)
    asked.header.frame_id = "panda_hand_tcp"
    back = bus.call("/compute_fk", asked)
    assert pose_from_message(back.pose_stamped[0].pose).isclose(SE3.identity(), 1e-9, 1e-9)
    assert back.pose_stamped[0].header.frame_id == "panda_hand_tcp"


def test_codes_of_kinematics(bus):
    assert ik(bus, (3.0, 0, 0)).error_code.val == -31  # NO_IK_SOLUTION
    assert ik(bus, group="leg").error_code.val == -15  # INVALID_GROUP_NAME
    fk = bus.call("/compute_fk", new("GetPositionFKRequest", fk_link_names=["tail"]))
    assert fk.error_code.val == -18  # INVALID_LINK_NAME
    inside = (0.55, 0.06, 0.15)  # of the wall
    assert ik(bus, inside).error_code.val == -31
    limit = new(
        "Constraints", joint_constraints=[new("JointConstraint", "panda_joint1", -2.5, 0.01, 0.01, 1.0)]
    )
    assert ik(bus, constraints=limit).error_code.val == -31


def test_validity_names_the_pair(bus, served):
    state = ik(bus).solution
    assert bus.call("/check_state_validity", new("GetStateValidityRequest", state, "arm")).valid
    down = new("RobotState")
    down.joint_state.name = ["panda_joint2", "panda_joint4"]
    down.joint_state.position = [1.5, -0.5]
    answer = bus.call("/check_state_validity", new("GetStateValidityRequest", down, "arm"))
    assert not answer.valid
    pairs = {frozenset((c.contact_body_1, c.contact_body_2)) for c in answer.contacts}
    assert any("table" in pair for pair in pairs)
    table = next(c for c in answer.contacts if "table" in (c.contact_body_1, c.contact_body_2))
    kinds = {table.contact_body_1: table.body_type_1, table.contact_body_2: table.body_type_2}
    assert kinds["table"] == 1 and table.depth > 0  # WORLD_OBJECT
    tight = new("Constraints", joint_constraints=[new("JointConstraint", "panda_joint1", 1.0, 0.1, 0.1, 1.0)])
    answer = bus.call(
        "/check_state_validity", new("GetStateValidityRequest", new("RobotState"), "arm", tight)
    )
    assert not answer.valid and not answer.constraint_result[0].result
    assert answer.constraint_result[0].distance == pytest.approx(1.0, abs=0.01)


# --- planning ---
def test_a_plan_is_timed_begins_at_zero_and_its_start_lists_all_joints(bus, served):
    before = arm(served)
    state, result, _ = move(bus, joint_goal({"panda_joint1": 0.4}), plan_only=True)
    assert state is GoalState.SUCCEEDED and result.error_code.val == 1
    points = result.planned_trajectory.joint_trajectory.points
    assert points[0].time_from_start.to_nsec() == 0
    assert all(len(p.velocities) == len(p.accelerations) == 7 for p in points)
    assert set(result.trajectory_start.joint_state.name) == set(served.live.model.movable_joint_names)
    assert points[-1].positions[0] == pytest.approx(0.4, abs=1e-4)
    assert np.allclose(arm(served), before)  # only planned


def test_plan_and_execute_with_feedback(bus, served):
    said = []
    state, result, _ = move(bus, joint_goal({"panda_joint1": 0.4}), feedback=lambda f: said.append(f.state))
    assert state is GoalState.SUCCEEDED and result.error_code.val == 1
    assert said == ["PLANNING", "MONITOR", "IDLE"]
    assert arm(served)[0] == pytest.approx(0.4, abs=1e-3)
    assert result.executed_trajectory.joint_trajectory.points


@pytest.mark.parametrize(
    "goals, fields, code",
    [
        ([], {}, -16),  # INVALID_GOAL_CONSTRAINTS
        ([new("Constraints")], {}, -16),
        ([joint_goal({"panda_joint1": 0.1})], {"group": "leg"}, -15),
        ([joint_goal({"elbow": 0.1})], {}, 99999),
        ([joint_goal({"panda_joint1": 0.1})], {"pipeline_id": "magic"}, 99999),
        ([joint_goal({"panda_joint1": 0.1})], {"planner_id": "RRTSprint"}, 99999),  # ours does not fall back
    ],
)
def test_codes_of_requests_that_cannot_be_planned(bus, goals, fields, code):
    state, result, text = move(bus, *goals, plan_only=True, **fields)
    assert state is GoalState.ABORTED and result.error_code.val == code and text


def test_a_refused_planner_is_named_with_those_that_exist(bus):
    _, _, text = move(bus, joint_goal({"panda_joint1": 0.1}), plan_only=True, planner_id="RRTConect")
    assert "RRTConect" in text and "RRTConnect" in text


def test_the_plan_service(bus, served):
    answer = bus.call(
        "/plan_kinematic_path", new("GetMotionPlanRequest", request(joint_goal({"panda_joint1": 0.3})))
    )
    found = answer.motion_plan_response
    assert found.error_code.val == 1 and found.group_name == "arm" and found.planning_time > 0
    shown = bus.subscribe("/move_group/display_planned_path", "moveit_msgs/DisplayTrajectory").get(2)
    assert shown.model_id == "panda" and shown.trajectory[0] == found.trajectory  # latched


def test_a_scene_diff_in_the_request_holds_for_that_plan_only(bus, served):
    wall = new(
        "CollisionObject",
        id="in_the_way",
        primitives=[S.new("shape_msgs/SolidPrimitive", 1, [0.2, 0.02, 1.0])],
    )
    wall.pose = pose_message(S, SE3.from_xyz(0.3, 0.14, 0.5))
    diff = new("PlanningScene", is_diff=True)
    diff.world.collision_objects = [wall]
    free = move(bus, joint_goal({"panda_joint1": 1.4}), plan_only=True)[1]
    around = move(bus, joint_goal({"panda_joint1": 1.4}), plan_only=True, scene_diff=diff)[1]
    assert around.error_code.val == 1

    def length(result):
        q = np.array([p.positions for p in result.planned_trajectory.joint_trajectory.points])
        return np.abs(np.diff(q, axis=0)).sum()

    assert length(around) > length(free) + 0.1
    assert "in_the_way" not in served.cell.scene().objects


def test_a_cartesian_path_that_is_partly_reachable_succeeds_with_a_fraction(bus, served):
    tip = served.cell.scene().frame_pose("panda_hand_tcp")

    def line(**offset):
        asked = new("GetCartesianPathRequest", group_name="arm", max_step=0.01, avoid_collisions=True)
        asked.start_state.is_diff = True
        asked.waypoints = [pose_message(S, tip.shifted(**offset))]
        return bus.call("/compute_cartesian_path", asked)

    whole = line(z=-0.1)
    assert whole.error_code.val == 1 and whole.fraction == 1.0 and whole.solution.joint_trajectory.points
    part = line(x=1.0)
    assert part.error_code.val == 1 and 0.1 < part.fraction < 0.9
    bad = new("GetCartesianPathRequest", group_name="leg", max_step=0.01, waypoints=[pose_message(S, tip)])
    assert bus.call("/compute_cartesian_path", bad).error_code.val == -15


# --- executing ---
def execute(bus, trajectory, cancel_after=None, stop_after=None):
    with ActionClient(bus, "/execute_trajectory", "moveit_msgs/ExecuteTrajectory") as client:
        sent = client.send_goal(new("ExecuteTrajectoryGoal", trajectory))
        if cancel_after is not None:
            time.sleep(cancel_after)
            sent.cancel()
        if stop_after is not None:
            time.sleep(stop_after)
            bus.advertise("/trajectory_execution_event", "std_msgs/String").publish(
                S.new("std_msgs/String", "stop")
            )
        assert sent.wait(30)
        return sent.state, sent.result.error_code.val


def slow_plan(bus):
    return move(bus, joint_goal({"panda_joint1": 1.5}), plan_only=True, max_velocity_scaling_factor=0.02)[
        1
    ].planned_trajectory


@pytest.mark.slow
def test_execution_its_start_its_end_and_its_stops(bus):
    planned = move(bus, joint_goal({"panda_joint1": 0.5}), plan_only=True)[1].planned_trajectory
    assert execute(bus, planned) == (GoalState.SUCCEEDED, 1)
    assert execute(bus, planned) == (GoalState.ABORTED, -4)  # CONTROL_FAILED: the arm is elsewhere by now
    assert execute(bus, new("RobotTrajectory")) == (GoalState.SUCCEEDED, 1)
    assert execute(bus, slow_plan(bus), cancel_after=0.2) == (GoalState.PREEMPTED, -7)
    assert execute(bus, slow_plan(bus), stop_after=0.2) == (GoalState.PREEMPTED, -7)


@pytest.mark.slow
def test_a_stop_ends_the_motion_where_it_is(bus, served):
    execute(bus, slow_plan(bus), stop_after=0.1)
    assert arm(served)[0] < 1.0  # of 1.5 rad, which take 1.7 s


@pytest.mark.slow
def test_a_cancelled_goal_is_preempted(bus):
    state, result, _ = move(
        bus, joint_goal({"panda_joint1": 1.5}), max_velocity_scaling_factor=0.02, cancel_after=0.5
    )
    assert state is GoalState.PREEMPTED and result.error_code.val == -7


@pytest.mark.slow
def test_a_goal_that_a_newer_one_replaces_says_so(bus):
    """Running or still waiting: its result never reads as a success."""
    with ActionClient(bus, "/move_group", "moveit_msgs/MoveGroup") as client:
        slow = request(joint_goal({"panda_joint1": 1.5}), max_velocity_scaling_factor=0.002)
        goals = [new("MoveGroupGoal", slow) for _ in range(3)]
        for goal in goals:
            goal.planning_options.planning_scene_diff.is_diff = True
        begun = threading.Event()
        first = client.send_goal(goals[0], lambda feedback: begun.set())
        assert begun.wait(20)
        second_began = threading.Event()
        second = client.send_goal(goals[1], lambda feedback: second_began.set())
        third = client.send_goal(goals[2])
        for sent, began in ((first, begun), (second, second_began)):  # a busy machine may begin the second
            assert sent.wait(20) and sent.state is (
                GoalState.PREEMPTED if began.is_set() else GoalState.RECALLED
            )
            assert sent.result.error_code.val == -7
            assert "preempted by a newer goal" in sent.result.error_code.message
            assert sent.text == sent.result.error_code.message
        third.cancel()
        assert third.wait(20) and third.result.error_code.val == -7
        assert "canceled by a client" in third.result.error_code.message


def test_reasons_are_in_the_error_code(bus):
    """Every service and action that answers with MoveIt's error codes."""

    def reason(code, *words):
        assert code.source == "armcell" and all(word in code.message for word in words), code

    state, result, _ = move(bus, joint_goal({"panda_joint1": 0.1}), group="leg")
    assert state is GoalState.ABORTED and result.error_code.val == -15
    reason(result.error_code, "planning group 'leg'", "arm")
    reason(move(bus, joint_goal({"panda_joint1": 9.0}))[1].error_code, "panda_joint1")
    planned = bus.call(
        "/plan_kinematic_path", new("GetMotionPlanRequest", request(joint_goal({"elbow": 0.1})))
    )
    reason(planned.motion_plan_response.error_code, "elbow")
    line = bus.call(
        "/compute_cartesian_path", new("GetCartesianPathRequest", group_name="leg", max_step=0.01)
    )
    assert line.error_code.val == -15
    reason(line.error_code, "leg")
    asked = new("GetPositionIKRequest", new("PositionIKRequest", "leg"))
    reason(bus.call("/compute_ik", asked).error_code, "leg")
    asked.ik_request.group_name = "arm"
    asked.ik_request.pose_stamped.pose.position.x = 9.0
    asked.ik_request.pose_stamped.pose.orientation.w = 1.0
    far = bus.call("/compute_ik", asked).error_code
    assert far.val == -31
    reason(far)
    link = bus.call("/compute_fk", new("GetPositionFKRequest", fk_link_names=["panda_tail"])).error_code
    assert link.val == -18
    reason(link, "panda_tail")
    trajectory = slow_plan(bus)
    trajectory.joint_trajectory.points[0].positions = [1.0] * 7
    with ActionClient(bus, "/execute_trajectory", "moveit_msgs/ExecuteTrajectory") as client:
        sent = client.send_goal(new("ExecuteTrajectoryGoal", trajectory))
        assert sent.wait(20) and sent.state is GoalState.ABORTED
        reason(sent.result.error_code, "panda_joint4", "limits")
        assert sent.text == sent.result.error_code.message
    assert move(bus, joint_goal({"panda_joint1": 0.1}))[1].error_code == new("MoveItErrorCodes", 1)


# --- the scene ---
def get_scene(bus, components=0):
    asked = new("GetPlanningSceneRequest", new("PlanningSceneComponents", components))
    return bus.call("/get_planning_scene", asked).scene


@pytest.mark.slow
def test_the_scene_is_edited_by_service_and_topics_and_told(bus, served):
    box = new(
        "CollisionObject", id="box", primitives=[S.new("shape_msgs/SolidPrimitive", 1, [0.1, 0.1, 0.1])]
    )
    box.pose = pose_message(S, SE3.from_xyz(0.0, 0.6, 0.3))
    told = bus.subscribe("/monitored_planning_scene", "moveit_msgs/PlanningScene", queue_size=100)
    diff = new("PlanningScene", is_diff=True)
    diff.world.collision_objects = [box]
    assert bus.call("/apply_planning_scene", new("ApplyPlanningSceneRequest", diff)).success
    assert "box" in [o.id for o in get_scene(bus).world.collision_objects]  # no waiting
    bad = new("CollisionObject", id="bad", header=S.new("std_msgs/Header", frame_id="nowhere"))
    bad.primitives = box.primitives
    diff.world.collision_objects = [bad]
    assert not bus.call("/apply_planning_scene", new("ApplyPlanningSceneRequest", diff)).success

    def wait_for(condition):
        end = time.monotonic() + 5
        while not condition(served.cell.scene()) and time.monotonic() < end:
            time.sleep(0.01)
        assert condition(served.cell.scene())

    removal = new("CollisionObject", id="box", operation=1)
    bus.advertise("/collision_object", "moveit_msgs/CollisionObject").publish(removal)
    wait_for(lambda scene: "box" not in scene.objects)
    held = new("AttachedCollisionObject", "panda_hand", box)
    held.object.header.frame_id = "panda_hand"
    bus.advertise("/attached_collision_object", "moveit_msgs/AttachedCollisionObject").publish(held)
    wait_for(lambda scene: "box" in scene.attached)
    diff.world.collision_objects = []
    diff.robot_state.attached_collision_objects = [new("AttachedCollisionObject", object=removal)]
    bus.advertise("/planning_scene", "moveit_msgs/PlanningScene").publish(diff)
    wait_for(lambda scene: "box" in scene.objects and "box" not in scene.attached)
    seen = [told.get(2) for _ in range(3)]
    assert any("box" in [o.id for o in m.world.collision_objects] for m in seen if m is not None)


def test_a_world_replaces_the_world(bus, served):
    from armcell.core import Octree
    from armcell.scene import OCTOMAP, with_octomap

    octree = Octree(np.array([[0.0, 0.6, 0.6]]), np.array([0.1]))
    served.cell.edit_scene(lambda scene: with_octomap(scene, octree))
    ball = new("CollisionObject", id="ball", primitives=[S.new("shape_msgs/SolidPrimitive", 2, [0.1])])
    ball.pose = pose_message(S, SE3.from_xyz(0.0, 0.6, 0.3))
    world = new("PlanningSceneWorld", collision_objects=[ball])
    with bus.advertise("/planning_scene_world", "moveit_msgs/PlanningSceneWorld") as publisher:
        publisher.publish(world)
    end = time.monotonic() + 5
    while "ball" not in served.cell.scene().objects and time.monotonic() < end:
        time.sleep(0.01)
    objects = served.cell.scene().objects
    assert "ball" in objects and "table" not in objects and OCTOMAP not in objects


def test_the_octomap_is_cleared(bus, served):
    from armcell.core import Octree
    from armcell.scene import OCTOMAP, with_octomap

    octree = Octree(np.array([[0.0, 0.6, 0.6]]), np.array([0.1]))
    served.cell.edit_scene(lambda scene: with_octomap(scene, octree))
    assert OCTOMAP in served.cell.scene().objects
    bus.call("/clear_octomap", S.new("std_srvs/EmptyRequest"))
    assert OCTOMAP not in served.cell.scene().objects


# --- planners ---
def test_planners_and_their_parameters(bus):
    found = bus.call("/query_planner_interface", new("QueryPlannerInterfacesRequest")).planner_interfaces
    by_pipeline = {d.pipeline_id: d.planner_ids for d in found}
    assert "RRTConnect" in by_pipeline["native"] and {"RRTConnect", "PRM", "RRTstar"} <= set(
        by_pipeline["ompl"]
    )
    key = {"pipeline_id": "ompl", "planner_config": "RRTConnect"}
    before = bus.call("/get_planner_params", new("GetPlannerParamsRequest", **key)).params
    assert "range" in before.keys
    setting = new("PlannerParams", ["range"], ["0.3"], [""])
    bus.call("/set_planner_params", new("SetPlannerParamsRequest", **key, group="arm", params=setting))
    after = bus.call("/get_planner_params", new("GetPlannerParamsRequest", **key, group="arm")).params
    assert dict(zip(after.keys, after.values))["range"] == "0.3"
    goal = joint_goal({"panda_joint1": 0.2})
    asked = {"plan_only": True, "pipeline_id": "ompl", "planner_id": "RRTConnect"}
    assert move(bus, goal, **asked)[1].error_code.val == 1
    bad = new("PlannerParams", ["rnge"], ["0.3"], [""])
    bus.call(
        "/set_planner_params", new("SetPlannerParamsRequest", **key, group="arm", params=bad, replace=True)
    )
    state, _, text = move(bus, goal, **asked)
    assert state is GoalState.ABORTED and "rnge" in text
    bus.call("/set_planner_params", new("SetPlannerParamsRequest", **key, group="arm", replace=True))
    assert not bus.call("/get_planner_params", new("GetPlannerParamsRequest", "magic", "x", "")).params.keys


# --- pickup ---
def test_grasps_of_another_link_than_the_tip_are_reported(served, bus):
    scene = served.cell.scene()
    over = SE3(SO3.from_rpy((np.pi, 0.0, 0.0)), scene.object("cube").T_world_object.translation)
    poses = {
        "panda_hand_tcp": over,
        "panda_link8": over @ scene.transform("panda_hand_tcp", "panda_link8"),
    }
    ends = {}
    for link, T in poses.items():
        grasp = new("Grasp")
        grasp.grasp_pose.header.frame_id = "world"
        grasp.grasp_pose.pose = pose_message(S, T)
        goal = new("PickupGoal", target_name="cube", group_name="arm", possible_grasps=[grasp])
        goal.planning_options.plan_only = True
        with ActionClient(bus, "/pickup", "moveit_msgs/Pickup") as client:
            sent = client.send_goal(goal)
            assert sent.wait(60)
        ends[link] = sent
    assert ends["panda_hand_tcp"].state is GoalState.SUCCEEDED, ends["panda_hand_tcp"].text
    sent = ends["panda_link8"]
    assert sent.state is GoalState.ABORTED and sent.result.error_code.val != 1
    assert "poses of panda_link8, but the tip of group 'arm' is panda_hand_tcp, 103 mm away" in sent.text
    assert "give grasp_pose for panda_hand_tcp" in sent.text
