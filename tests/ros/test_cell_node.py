"""A cell on the bus, and seen by Unity over TCP."""

import threading
import time

import numpy as np
import pytest
from tests.ros.unity_like import UnityLike

from armcell.cell import load
from armcell.core import SE3, InputError
from armcell.kinematics import kinematic_tree
from armcell.ros import ActionClient, Bus, GoalState, schema
from armcell.ros.codec import ros1_codec
from armcell.ros.nodes import CellNode
from armcell.ros.nodes.state_publisher import ArmStatusPublisher
from armcell.ros.tcp import RosTcpServer, ServerSettings

TRAJECTORY = "trajectory_msgs/JointTrajectory"
SCALE = 10.0


@pytest.fixture
def served():
    """A panda_pick that follows exactly, ten times as fast as the clock: (bus, node)."""
    bus, before = Bus(), threading.active_count()
    node = CellNode(load("panda_pick").connect("fake", 0, time_scale=SCALE), bus)
    thread = node.start()
    assert node.ready.wait(120)
    yield bus, node
    node.close()
    thread.join(5)
    assert not thread.is_alive()
    end = time.monotonic() + 5
    while threading.active_count() > before and time.monotonic() < end:
        time.sleep(0.01)
    assert threading.active_count() <= before


def trajectory(node, shift, duration, start=0.0):
    names = list(node.live.model.groups["arm"].joint_names)
    q = node.live.driver.joint_state().reindexed(names).positions
    points = []
    for t, add in ((start, 0.0), (start + duration, shift)):
        at = schema().message("builtin_interfaces/Duration").from_sec(t)
        zero = np.zeros(len(names))
        points.append(
            schema().new(
                "trajectory_msgs/JointTrajectoryPoint",
                positions=q + add * (np.arange(len(names)) == 0),
                velocities=zero,
                time_from_start=at,
            )
        )
    return schema().new(TRAJECTORY, joint_names=names, points=points), q[0] + shift


def first_joint(node):
    names = node.live.model.groups["arm"].joint_names
    return node.live.driver.joint_state()[names[0]]


def next_status(status, start, timeout=10.0):
    end = time.monotonic() + timeout
    while time.monotonic() < end:
        message = status.get(timeout=1.0)
        if message is not None and message.data.startswith(start):
            return message.data
    pytest.fail(f"no status {start!r}")


def test_states_come_at_thirty_hertz_of_the_cells_clock(served):
    bus, node = served
    states = bus.subscribe("/joint_states", "sensor_msgs/JointState", queue_size=1000)
    clock = bus.subscribe("/clock", "rosgraph_msgs/Clock", queue_size=1000)
    stamps = [states.get(5).header.stamp.to_sec() for _ in range(91)]
    assert np.all(np.diff(stamps) > 0)
    assert 29.5 < 90 / (stamps[-1] - stamps[0]) < 30.5
    assert clock.get(5).clock.to_sec() in stamps
    mimics = ("panda_finger_joint2",)  # last, where it disturbs nobody
    assert tuple(states.get(5).name) == (*node.live.model.joint_names, *mimics)


@pytest.mark.slow
def test_each_of_several_arms_has_its_own_joint_states():
    bus = Bus()
    node = CellNode(load("dual_ur10").connect("fake", None, time_scale=SCALE), bus)
    thread = node.start()
    try:
        assert node.ready.wait(300)
        whole = bus.subscribe("/joint_states", "sensor_msgs/JointState", queue_size=1).get(5)
        at = dict(zip(whole.name, whole.position))
        for arm in ("left", "right"):
            mine = bus.subscribe(f"/{arm}_arm/joint_states", "sensor_msgs/JointState", queue_size=1).get(5)
            assert len(mine.name) == 8 and all(name.startswith(f"{arm}_") for name in mine.name)
            assert [at[name] for name in mine.name] == pytest.approx(list(mine.position), abs=1e-6)
            assert len(mine.velocity) == 8
    finally:
        node.close()
        thread.join(10)


def test_the_transform_tree_leads_from_the_world_to_every_link_and_object(served):
    bus, node = served
    message = bus.subscribe("/tf", "tf2_msgs/TFMessage").get(5)
    tf = {}
    for t in message.transforms:
        v, r = t.transform.translation, t.transform.rotation
        assert t.child_frame_id not in tf
        tf[t.child_frame_id] = (
            t.header.frame_id,
            SE3.from_quat_xyzw((v.x, v.y, v.z), (r.x, r.y, r.z, r.w)),
        )
    model, scene = node.live.model, node.live.scene_at_start
    tree, q = kinematic_tree(model), scene.positions
    for link in model.links:
        T, frame = SE3.identity(), link
        while frame != "world":
            parent, step = tf[frame]
            T, frame = step @ T, parent
        assert T.isclose(tree.link_pose(q, link), 1e-6, 1e-6), link
    for name, item in scene.objects.items():
        assert tf[name][0] == "world"
        assert tf[name][1].isclose(item.T_world_object, 1e-6, 1e-6)


def test_the_only_object_is_published_under_both_names(served):
    bus, node = served
    for topic in ("/object_pose", "/object_pose/cube"):
        message = bus.subscribe(topic, "geometry_msgs/PoseStamped").get(5)
        xyz = node.live.driver.object_poses()["cube"].translation
        position = message.pose.position
        assert message.header.frame_id == "world"
        assert np.allclose((position.x, position.y, position.z), xyz, atol=1e-6)


def test_a_trajectory_is_played_and_reported(served):
    bus, node = served
    status = bus.subscribe("/trajectory_status", "std_msgs/String", queue_size=50)
    message, goal = trajectory(node, 0.3, 1.0)
    bus.advertise("/planned_trajectory", TRAJECTORY).publish(message)
    assert next_status(status, "executing") == "executing 2 points, 1.00 s"
    assert next_status(status, "done")
    assert abs(first_joint(node) - goal) < 1e-3 and node.executed == 1


def test_a_newer_trajectory_takes_over_and_an_empty_one_stops(served):
    bus, node = served
    status = bus.subscribe("/trajectory_status", "std_msgs/String", queue_size=50)
    publisher = bus.advertise("/planned_trajectory", TRAJECTORY)
    publisher.publish(trajectory(node, 1.0, 20.0)[0])
    next_status(status, "executing")
    newer, goal = trajectory(node, 0.2, 1.0, start=0.5)  # blends in from wherever the arm is by then
    publisher.publish(newer)
    assert "cancelled at" in next_status(status, "stopped")
    next_status(status, "done")
    assert abs(first_joint(node) - goal) < 1e-3
    publisher.publish(trajectory(node, 1.0, 20.0)[0])
    next_status(status, "executing")
    publisher.publish(schema().new(TRAJECTORY))
    next_status(status, "stopped")
    assert next_status(status, "stop") == "stop"
    assert "empty trajectory" in next_status(status, "done")


def test_what_cannot_be_played_is_refused_and_the_cell_goes_on(served):
    bus, node = served
    status = bus.subscribe("/trajectory_status", "std_msgs/String", queue_size=50)
    publisher = bus.advertise("/planned_trajectory", TRAJECTORY)
    bad, _ = trajectory(node, float("nan"), 1.0)
    publisher.publish(bad)
    assert "not finite" in next_status(status, "refused")
    bad, _ = trajectory(node, 0.1, 1.0)
    bad.joint_names[0] = "elbow"
    publisher.publish(bad)
    assert "unknown joint 'elbow'" in next_status(status, "refused")
    bad, _ = trajectory(node, 0.1, 1.0)
    for point in bad.points:
        point.positions = point.positions + 0.2
    publisher.publish(bad)
    assert "from the trajectory's start" in next_status(status, "refused")
    good, goal = trajectory(node, 0.1, 0.5)
    publisher.publish(good)
    next_status(status, "done")
    assert abs(first_joint(node) - goal) < 1e-3


def test_follow_joint_trajectory(served):
    bus, node = served
    with ActionClient(
        bus, "/arm_controller/follow_joint_trajectory", "control_msgs/FollowJointTrajectory"
    ) as client:
        goal = schema().new("control_msgs/FollowJointTrajectoryGoal")
        goal.trajectory, target = trajectory(node, 0.2, 1.0)
        sent = client.send_goal(goal)
        assert sent.wait(10) and sent.state is GoalState.SUCCEEDED and sent.result.error_code == 0
        assert abs(first_joint(node) - target) < 1e-3
        goal.trajectory, _ = trajectory(node, 1.0, 30.0)
        sent = client.send_goal(goal)
        time.sleep(0.2)
        sent.cancel()
        assert sent.wait(10) and sent.state is GoalState.PREEMPTED
        goal.trajectory, _ = trajectory(node, 0.1, 1.0)
        goal.trajectory.joint_names[0] = "elbow"
        sent = client.send_goal(goal)
        assert sent.wait(10) and sent.state is GoalState.REJECTED and sent.result.error_code == -2


@pytest.mark.parametrize("fault", ["joint", "start", "numbers", "gripper"])
def test_a_refused_goal_goes_from_pending_to_rejected(served, fault):
    bus, node = served
    name, kind = "/arm_controller/follow_joint_trajectory", "FollowJointTrajectory"
    if fault == "gripper":
        gripper = next(iter(node.live.model.grippers))
        name, kind = f"/{gripper}_controller/gripper_cmd", "GripperCommand"
    goal = schema().new(f"control_msgs/{kind}Goal")
    if fault == "gripper":
        goal.command.position = float("nan")
    else:
        goal.trajectory, _ = trajectory(node, float("nan") if fault == "numbers" else 0.1, 1.0)
    if fault == "joint":
        goal.trajectory.joint_names[0] = "elbow"
    if fault == "start":
        for point in goal.trajectory.points:
            point.positions = point.positions + 0.2
    status = bus.subscribe(f"{name}/status", "actionlib_msgs/GoalStatusArray", queue_size=50)
    with ActionClient(bus, name, f"control_msgs/{kind}") as client:
        sent = client.send_goal(goal)
        assert sent.wait(10) and sent.state is GoalState.REJECTED and sent.text
        if fault != "gripper":
            code = -2 if fault == "joint" else -1
            assert (sent.result.error_code, sent.result.error_string) == (code, sent.text)
        states = []
        while GoalState.REJECTED not in states:
            for one in status.get(timeout=5).status_list:
                states += [GoalState(one.status)] if one.goal_id.id == sent.id.id else []
        assert set(states) == {GoalState.PENDING, GoalState.REJECTED}


def test_gripper_commands(served):
    bus, node = served
    publisher = bus.advertise("/gripper_command", "std_msgs/Float64")
    gripper = next(iter(node.live.model.grippers))
    for value, width in ((0.03, 0.03), (5.0, 0.08), (-20.0, 0.0)):
        publisher.publish(schema().new("std_msgs/Float64", value))
        end = time.monotonic() + 5
        while abs(node.live.driver.gripper(gripper).width - width) > 1e-3 and time.monotonic() < end:
            time.sleep(0.01)
        assert abs(node.live.driver.gripper(gripper).width - width) < 1e-3
    status = bus.subscribe("/trajectory_status", "std_msgs/String")
    publisher.publish(schema().new("std_msgs/Float64", float("nan")))
    assert "nan" in next_status(status, "refused")


def test_a_node_that_ends_leaves_the_bus():
    bus = Bus()
    node = CellNode(load("panda_pick").connect("fake", 0, time_scale=SCALE), bus)
    thread = node.start()
    assert node.ready.wait(120) and len(bus.topics()) > 8
    node.close()
    thread.join(5)
    assert bus.topics() == []


@pytest.mark.slow
def test_a_motion_that_was_put_during_the_proof_of_another_is_proven_beside_it():
    """Two threads, each with one arm's motion: neither may begin unproven beside the other."""
    node = CellNode(load("dual_ur10").connect("fake", None, time_scale=SCALE), Bus())
    thread = node.start()
    assert node.ready.wait(120)

    def swing(side):
        names = list(node.live.model.group(f"{side}_arm").joint_names)
        q = node.live.driver.joint_state().reindexed(names).positions
        end = q + 0.2 * (np.arange(len(names)) == 0)
        return schema().new(
            TRAJECTORY,
            joint_names=names,
            points=[
                schema().new(
                    "trajectory_msgs/JointTrajectoryPoint",
                    positions=p,
                    time_from_start=schema().message("builtin_interfaces/Duration").from_sec(t),
                )
                for t, p in ((0.0, q), (5.0, end))
            ],
        )

    proofs, proven, left = [], node._temporary_conflict, []

    def contact(others, new):
        proofs.append((new.joint_names[0].split("_")[0], len(others)))
        found = proven(others, new)
        if not left:
            left.append(None)
            left[0] = node.queue_trajectory(swing("left"))  # from another thread, just now
        return found

    node._temporary_conflict = contact
    try:
        right = node.queue_trajectory(swing("right"))
        assert proofs == [("right", 0), ("left", 0), ("right", 1)]
        assert left[0].wait(20) and right.wait(20) and left[0].outcome().ok and right.outcome().ok
    finally:
        node.close()
        thread.join(5)


@pytest.mark.slow
def test_unity_moves_the_arm_in_physics_over_tcp():
    bus = Bus()
    node = CellNode(load("panda_pick").connect("sim", 0, time_scale=1.0), bus)
    thread = node.start()
    assert node.ready.wait(120)
    try:
        with RosTcpServer(bus, ServerSettings(port=0)) as server, UnityLike(server.address) as unity:
            unity.register("__subscribe", "joint_states", "sensor_msgs/JointState")
            unity.register("__subscribe", "/trajectory_status", "std_msgs/String")
            unity.register("__publish", "/planned_trajectory", TRAJECTORY)
            message, goal = trajectory(node, 0.2, 1.5)
            unity.message("/planned_trajectory", ros1_codec().encode(message))
            last, said = None, []
            while not (said and said[-1].startswith(("done", "failed"))):
                name, body = unity.read(timeout=20)
                if name == "joint_states":
                    last = ros1_codec().decode("sensor_msgs/JointState", body)
                elif name == "/trajectory_status":
                    said.append(ros1_codec().decode("std_msgs/String", body).data)
            assert said[-1].startswith("done"), said
            joint = node.live.model.groups["arm"].joint_names[0]
            assert abs(last.position[last.name.index(joint)] - goal) < 0.05
    finally:
        node.close()
        thread.join(5)


@pytest.mark.parametrize("mode, highest", [("fake", 100), ("sim", 250)])
def test_a_rate_above_the_driver_s_is_refused_with_the_highest(mode, highest):
    live = load("panda_pick").connect(mode, 0)
    with pytest.raises(InputError, match=f"{highest * 2} Hz.*--rate {highest} or less"):
        CellNode(live, Bus(), rate=highest * 2.0)
    CellNode(live, Bus(), rate=float(highest))


def test_both_fingers_are_in_the_joint_states(served):
    bus, _ = served
    bus.advertise("/gripper_command", "std_msgs/Float64").publish(schema().new("std_msgs/Float64", 0.03))
    states = bus.subscribe("/joint_states", "sensor_msgs/JointState", queue_size=1)
    end = time.monotonic() + 5
    while time.monotonic() < end:
        message = states.get(5)
        by_name = dict(zip(message.name, message.position))
        assert by_name["panda_finger_joint1"] == by_name["panda_finger_joint2"]
        if abs(by_name["panda_finger_joint2"] - 0.015) < 1e-3:
            break
    assert abs(by_name["panda_finger_joint2"] - 0.015) < 1e-3
    assert len(message.velocity) in (0, len(message.name))


def test_late_subscribers_get_the_modes_and_a_wrench_follows(served):
    bus, _ = served
    robot = bus.subscribe("/robot_mode", "ur_dashboard_msgs/RobotMode").get(5)
    safety = bus.subscribe("/safety_mode", "ur_dashboard_msgs/SafetyMode").get(5)
    assert (robot.mode, safety.mode) == (robot.RUNNING, safety.NORMAL)
    wrench = bus.subscribe("/wrench", "geometry_msgs/WrenchStamped").get(5)
    assert wrench.header.frame_id == "panda_hand_tcp"


@pytest.mark.slow
def test_the_wrench_is_the_load_on_the_hand():
    """A held object of mass m pulls with m g, downward: along the tool's z axis, which points down."""
    live = load("panda_pick").connect("sim", 1)
    bus = Bus()
    with live:
        assert live.arm.pick("cube").ok
        status = ArmStatusPublisher(bus, live.model)
        got = bus.subscribe("/wrench", "geometry_msgs/WrenchStamped", queue_size=200)
        for _ in range(100):
            live.driver.advance(live.driver.period)
            status.publish(live.driver)
        forces = np.array([[m.wrench.force.x, m.wrench.force.y, m.wrench.force.z] for m in _drain(got)])
        mass = live.scene().attached["cube"].object.mass
        R = live.scene().frame_pose("panda_hand_tcp").rotation.matrix
        assert np.allclose(R @ forces.mean(axis=0), (0, 0, -9.81 * mass), atol=0.05 * 9.81 * mass)


def _drain(subscription):
    while (message := subscription.get(0)) is not None:
        yield message
