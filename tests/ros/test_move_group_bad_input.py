"""move_group and whatever comes over a wire: answered, refused or ignored, and the next one is served."""

from __future__ import annotations

import logging
import time

import numpy as np
import pytest
from tests.ros.helpers import random_message
from tests.ros.unity_like import UnityLike

from armcell.cell import load
from armcell.ros import ActionClient, Bus, cdr_codec, schema
from armcell.ros.bus import ServiceError
from armcell.ros.codec import ros1_codec
from armcell.ros.nodes import ServedCell
from armcell.ros.tcp import RosTcpServer, ServerSettings

S = schema()
ROUNDS = 40  # of each service and topic


@pytest.fixture(scope="module")
def served():
    with ServedCell(load("panda_pick").connect("fake", None, time_scale=20.0), Bus()) as cell:
        yield cell


def sane(served):
    """An ordinary request is answered as ever."""
    asked = S.new("moveit_msgs/GetPositionFKRequest", fk_link_names=["panda_hand"])
    return served.bus.call("/compute_fk", asked).error_code.val == 1


SERVICES = (
    "/compute_ik", "/compute_fk", "/check_state_validity", "/plan_kinematic_path", "/compute_cartesian_path",
    "/apply_planning_scene", "/get_planning_scene", "/get_planner_params",
)  # fmt: skip


@pytest.mark.slow
@pytest.mark.cases("/plan_kinematic_path", "/apply_planning_scene", "/compute_fk", "/get_*")
@pytest.mark.parametrize("name", SERVICES)
def test_random_requests(served, name, caplog):
    rng = np.random.default_rng(0)
    kind = f"{served.bus.services()[name]}Request"
    with caplog.at_level(logging.ERROR):
        for _ in range(ROUNDS):
            request = random_message(S, kind, rng)
            if name == "/plan_kinematic_path":
                request.motion_plan_request.group_name = "arm"
            try:
                assert served.bus.call(name, request)._type == kind.replace("Request", "Response")
            except ServiceError as error:
                pytest.fail(f"{name}: {error}")
    assert not [r for r in caplog.records if r.levelno >= logging.ERROR]
    assert sane(served)


@pytest.mark.slow
@pytest.mark.parametrize(
    "topic", ["/planning_scene", "/collision_object", "/attached_collision_object", "/planned_trajectory"]
)
def test_random_messages(served, topic, caplog):
    rng, kind = np.random.default_rng(1), served.bus.topic_type(topic)
    with served.bus.advertise(topic, kind) as publisher, caplog.at_level(logging.ERROR):
        for _ in range(ROUNDS):
            publisher.publish(random_message(S, kind, rng))
        time.sleep(0.5)
    assert not [r for r in caplog.records if r.levelno >= logging.ERROR]
    assert sane(served)


@pytest.mark.parametrize(
    "action, kind",
    [
        ("/move_group", "MoveGroup"),
        ("/execute_trajectory", "ExecuteTrajectory"),
        ("/pickup", "Pickup"),
        ("/place", "Place"),
    ],
)
def test_random_goals(served, action, kind, caplog):
    rng = np.random.default_rng(2)
    with ActionClient(served.bus, action, f"moveit_msgs/{kind}") as client, caplog.at_level(logging.ERROR):
        for _ in range(10):
            sent = client.send_goal(random_message(S, f"moveit_msgs/{kind}Goal", rng))
            assert sent.wait(20) and sent.state.is_terminal
    assert not [r for r in caplog.records if r.levelno >= logging.ERROR]
    assert sane(served)


@pytest.mark.parametrize("ros2", [False, True])
def test_services_over_tcp(served, ros2):
    """As Unity asks them: the tutorial's planner services in both modes."""
    codec = cdr_codec() if ros2 else ros1_codec()
    with RosTcpServer(served.bus, ServerSettings(port=0)) as server, UnityLike(server.address, ros2) as unity:

        def call(name, request):
            unity.register("__ros_service", name, request._type.removesuffix("Request"))
            number = unity.call(name, bytes(codec.encode(request)))
            assert unity.read_until("__response", 20)["srv_id"] == number
            return codec.decode(request._type.replace("Request", "Response"), unity.read_until(name))

        asked = S.new("moveit_msgs/PositionIKRequest", group_name="arm")
        asked.pose_stamped.pose.position = S.new("geometry_msgs/Point", 0.5, 0.1, 0.4)
        asked.pose_stamped.pose.orientation = S.new("geometry_msgs/Quaternion", x=1.0)
        found = call("/compute_ik", S.new("moveit_msgs/GetPositionIKRequest", asked))
        assert found.error_code.val == 1
        goal = [
            S.new("moveit_msgs/JointConstraint", n, p, 1e-3, 1e-3, 1.0)
            for n, p in zip(found.solution.joint_state.name, found.solution.joint_state.position)
            if "finger" not in n
        ]
        plan = S.new("moveit_msgs/MotionPlanRequest", group_name="arm", allowed_planning_time=5.0)
        plan.goal_constraints = [S.new("moveit_msgs/Constraints", joint_constraints=goal)]
        response = call("/plan_kinematic_path", S.new("moveit_msgs/GetMotionPlanRequest", plan))
        points = response.motion_plan_response.trajectory.joint_trajectory.points
        assert response.motion_plan_response.error_code.val == 1 and len(points) > 10
        assert np.allclose(points[-1].positions, [c.position for c in goal], atol=1e-3)
        scene = call("/get_planning_scene", S.new("moveit_msgs/GetPlanningSceneRequest")).scene
        assert {"table", "cube"} <= {o.id for o in scene.world.collision_objects}
