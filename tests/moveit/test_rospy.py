"""rospy, actionlib, tf and the message packages: what scripts do with them."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from armcell.ros.codec import ros1_codec


@pytest.fixture
def rospy(session):
    import rospy

    return rospy


# --- messages ---
def test_packages_of_messages_and_services(session):
    import geometry_msgs.msg
    from moveit_msgs.msg import Grasp, MoveItErrorCodes
    from moveit_msgs.srv import GetPositionIK, GetPositionIKRequest
    from std_srvs.srv import Trigger

    assert MoveItErrorCodes.SUCCESS == 1 and MoveItErrorCodes.NO_IK_SOLUTION == -31
    assert isinstance(GetPositionIK.Request(), GetPositionIKRequest) and Trigger._type == "std_srvs/Trigger"
    assert Grasp().grasp_pose.pose.orientation.w == 0.0  # as genpy: nothing is made up
    assert geometry_msgs.msg.Point(1, 2, 3).y == 2
    from moveit_msgs.msg import GetPlanningScene  # as tutorials import it: a service, with a hint
    from moveit_msgs.srv import GetPlanningScene as Right

    assert GetPlanningScene._request_class is Right._request_class
    assert "moveit_msgs/GetPlanningScene" in session.hints
    with pytest.raises(ImportError):
        from moveit_msgs.msg import GetPlanningScenes  # noqa: F401


def test_messages_are_lists_and_texts_as_scripts_use_them(session):
    from geometry_msgs.msg import PoseStamped
    from sensor_msgs.msg import Image, JointState
    from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

    trajectory = JointTrajectory()
    trajectory.joint_names.append("a")
    trajectory.points.append(JointTrajectoryPoint(positions=[1.0]))
    trajectory.points[0].positions.append(2.0)
    assert trajectory.points[0].velocities == [] and Image().data == b""
    pose = PoseStamped()
    pose.header.frame_id = "world"
    assert 'frame_id: "world"' in str(pose) and "position: \n" in str(pose) and "secs: 0" in str(pose)
    assert PoseStamped() == PoseStamped() and pose != PoseStamped()
    state = JointState(name=["a"], position=[0.5])
    for message in (pose, state, trajectory):
        decoded = ros1_codec().decode(message._type, bytes(ros1_codec().encode(message)))
        assert session.messages.local(decoded) == message
    assert session.messages.local(state).position == (0.5,)  # what comes from the wire are tuples


def test_times_and_durations(rospy):
    assert rospy.Time(1.5).secs == 1 and rospy.Time(1.5).nsecs == 500_000_000
    assert rospy.Duration(1, -500_000_000) == rospy.Duration.from_sec(0.5)
    assert rospy.Time(3) - rospy.Time(1, 5) == rospy.Duration(1, 999_999_995)
    assert rospy.Time(3) + rospy.Duration(0.25) == rospy.Time(3.25) and rospy.Time(1) < rospy.Time(1, 1)
    assert (rospy.Duration(2) * 1.5).to_sec() == 3.0 and rospy.Duration(3) / rospy.Duration(2) == 1.5
    assert -rospy.Duration(0.5) == rospy.Duration(-0.5) and rospy.Duration(-0.5).secs == -1
    assert not rospy.Duration() and rospy.Time(0).is_zero()
    with pytest.raises(TypeError):
        rospy.Time(-1)


# --- topics ---
def test_publishers_and_subscribers_have_copies_of_their_own(rospy):
    from geometry_msgs.msg import Point
    from std_msgs.msg import String

    got = []
    subscriber = rospy.Subscriber("talk", Point, lambda m, more: got.append((m, more)), "extra")
    publisher = rospy.Publisher("/talk", Point, queue_size=1)
    assert publisher.get_num_connections() == 1
    point = Point(1.0, 2.0, 3.0)
    publisher.publish(point)
    point.x = 99.0  # after it was published
    publisher.publish(y=5.0)
    end = time.monotonic() + 5
    while len(got) < 2 and time.monotonic() < end:
        time.sleep(0.01)
    assert [(m.x, m.y) for m, _ in got] == [(1.0, 2.0), (0.0, 5.0)] and got[0][1] == "extra"
    with pytest.raises(rospy.ROSException):
        publisher.publish(String("no"))
    with pytest.raises(rospy.ROSException):
        rospy.Subscriber("/talk", String, print)
    subscriber.unregister()
    publisher.unregister()
    with pytest.raises(rospy.ROSException):
        publisher.publish(point)


def test_a_callback_that_fails_is_told_and_the_next_one_comes(rospy, session):
    from std_msgs.msg import Int32

    got = []

    def callback(message):
        got.append(message.data)
        raise ValueError("in the callback")

    subscriber = rospy.Subscriber("/fails", Int32, callback)
    publisher = rospy.Publisher("/fails", Int32, queue_size=5)
    publisher.publish(1)
    publisher.publish(2)
    end = time.monotonic() + 5
    while len(got) < 2 and time.monotonic() < end:
        time.sleep(0.01)
    assert got == [1, 2] and any("bad callback" in line for line in session.lines)
    subscriber.unregister()


def test_waiting_for_messages(rospy):
    from sensor_msgs.msg import JointState
    from std_msgs.msg import String

    state = rospy.wait_for_message("/joint_states", JointState, timeout=5)
    assert "panda_joint1" in state.name and isinstance(state.position, tuple)
    with pytest.raises(rospy.ROSException, match="timeout"):
        rospy.wait_for_message("/never", String, timeout=1.0)
    assert ["/joint_states", "sensor_msgs/JointState"] in rospy.get_published_topics()


# --- services and parameters ---
def test_services_take_whatever_a_handler_gives(rospy):
    from std_srvs.srv import SetBool, SetBoolResponse, Trigger

    given = iter(
        [SetBoolResponse(True, "as it is"), (True, "tuple"), {"success": True, "message": "dict"}, None]
    )
    service = rospy.Service("choose", SetBool, lambda request: next(given))
    rospy.wait_for_service("/choose", timeout=1)
    proxy = rospy.ServiceProxy("choose", SetBool)
    assert [proxy(True).message, proxy(data=True).message, proxy(True).message] == [
        "as it is",
        "tuple",
        "dict",
    ]
    with pytest.raises(rospy.ServiceException):
        proxy(True)
    service.shutdown()
    with pytest.raises(rospy.ServiceException, match="choose"):
        proxy(True)
    with pytest.raises(rospy.ROSException):
        rospy.wait_for_service("/choose", timeout=0.2)
    assert Trigger._request_class()._type == "std_srvs/TriggerRequest"


def test_parameters(rospy):
    rospy.set_param("/gains", {"p": 1.0, "i": 0.1})
    assert rospy.get_param("gains/p") == 1.0 and rospy.has_param("/gains")
    assert rospy.get_param("/nothing", 7) == 7
    with pytest.raises(KeyError):
        rospy.get_param("/nothing")
    rospy.delete_param("/gains")
    with pytest.raises(KeyError):
        rospy.delete_param("/gains")
    rospy.init_node("tester")
    rospy.set_param("~own", 3)
    assert rospy.get_param("/tester/own") == 3 and rospy.get_name() == "/tester"
    with pytest.raises(rospy.ROSException):
        rospy.init_node("other")


# --- time ---
@pytest.mark.slow
def test_sleep_and_rate_follow_the_cells_clock(rospy):
    began, wall = rospy.get_time(), time.monotonic()
    rospy.sleep(20.0)
    assert rospy.get_time() - began > 19.99
    assert time.monotonic() - wall < 10.0  # twenty times as fast as the wall's
    rate, began = rospy.Rate(10), rospy.get_time()
    for _ in range(10):
        rate.sleep()
    assert rospy.get_time() - began > 0.9
    ticks, began = [], rospy.get_time()
    timer = rospy.Timer(rospy.Duration(0.2), ticks.append)
    rospy.sleep(1.1)
    timer.shutdown()
    assert 4 <= len(ticks) <= (rospy.get_time() - began) / 0.2 + 1 and ticks[0].current_real.to_sec() > 0


def test_logging(rospy, session):
    rospy.loginfo("%d of %s", 3, "four")
    rospy.logwarn_once("once")
    rospy.logwarn_once("once")
    rospy.loginfo_throttle(1000.0, "seldom")
    rospy.loginfo_throttle(1000.0, "seldom")
    assert sum("3 of four" in line for line in session.lines) == 1
    assert sum("once" in line for line in session.lines) == 1
    assert sum("seldom" in line for line in session.lines) == 1


# --- actionlib ---
def test_an_action_server_and_its_client(rospy, session):
    import actionlib
    from control_msgs.msg import (
        GripperCommandAction,
        GripperCommandFeedback,
        GripperCommandGoal,
        GripperCommandResult,
    )

    def execute(goal):
        server.publish_feedback(GripperCommandFeedback(position=0.5))
        if goal.command.position < 0:
            server.set_aborted(text="negative")
        elif goal.command.position > 1:
            while not server.is_preempt_requested():
                time.sleep(0.01)
            server.set_preempted()
        else:
            server.set_succeeded(GripperCommandResult(position=goal.command.position))

    server = actionlib.SimpleActionServer("/hand", GripperCommandAction, execute, auto_start=False)
    server.start()
    client = actionlib.SimpleActionClient("hand", GripperCommandAction)
    assert client.wait_for_server(rospy.Duration(5))
    goal, fed, done = GripperCommandGoal(), [], threading.Event()
    goal.command.position = 0.25
    client.send_goal(goal, lambda state, result: done.set(), feedback_cb=fed.append)
    assert client.wait_for_result(rospy.Duration(60)) and client.get_state() == actionlib.GoalStatus.SUCCEEDED
    assert client.get_result().position == 0.25 and done.wait(5) and fed[0].position == 0.5
    goal.command.position = -1.0
    assert client.send_goal_and_wait(goal) == actionlib.GoalStatus.ABORTED
    assert client.get_goal_status_text() == "negative"
    goal.command.position = 2.0
    client.send_goal(goal)
    assert not client.wait_for_result(rospy.Duration(2.0))
    client.cancel_goal()
    assert client.wait_for_result() and client.get_state() == actionlib.GoalStatus.PREEMPTED


def test_a_callback_of_an_action_that_fails_aborts_its_goal(rospy, session):
    import actionlib
    from control_msgs.msg import GripperCommandAction, GripperCommandGoal

    def execute(goal):
        raise ValueError("in the callback")

    actionlib.SimpleActionServer("/broken", GripperCommandAction, execute)
    client = actionlib.SimpleActionClient("/broken", GripperCommandAction)
    before = threading.active_count()
    assert client.send_goal_and_wait(GripperCommandGoal()) == actionlib.GoalStatus.ABORTED
    assert "in the callback" in client.get_goal_status_text()
    end = time.monotonic() + 5
    while threading.active_count() > before and time.monotonic() < end:
        time.sleep(0.01)
    assert threading.active_count() <= before


def test_the_cells_own_actions(rospy, session):
    import actionlib
    from control_msgs.msg import GripperCommandAction, GripperCommandGoal

    client = actionlib.SimpleActionClient("/hand_controller/gripper_cmd", GripperCommandAction)
    assert client.wait_for_server()
    goal = GripperCommandGoal()
    goal.command.position = 0.02
    assert client.send_goal_and_wait(goal) == 3
    assert client.get_result().position == pytest.approx(0.02, abs=2e-3) and client.get_result().reached_goal


# --- tf ---
def test_transforms(rospy, session):
    import tf
    import tf2_ros
    from geometry_msgs.msg import PoseStamped

    scene = session.served.cell.scene()
    expected = scene.frame_pose("panda_link0").inverse() @ scene.frame_pose("panda_hand")
    buffer = tf2_ros.Buffer()
    tf2_ros.TransformListener(buffer)
    found = buffer.lookup_transform("panda_link0", "panda_hand", rospy.Time(0), rospy.Duration(5)).transform
    assert np.allclose((found.translation.x, found.translation.y, found.translation.z), expected.translation)
    with pytest.raises(tf2_ros.LookupException):
        buffer.lookup_transform("world", "nowhere", rospy.Time(0))
    listener = tf.TransformListener()
    listener.waitForTransform("world", "panda_hand", rospy.Time(), rospy.Duration(5))
    xyz, quat = listener.lookupTransform("panda_link0", "panda_hand", rospy.Time(0))
    assert np.allclose(xyz, expected.translation) and np.isclose(abs(np.dot(quat, expected.quat_xyzw)), 1.0)
    sender = tf.TransformBroadcaster()
    pose = PoseStamped()
    pose.header.frame_id, pose.pose.orientation.w = "lamp", 1.0
    end = time.monotonic() + 5
    while not buffer.can_transform("world", "lamp") and time.monotonic() < end:
        sender.sendTransform((0, 0, 1), (0, 0, 0, 1), rospy.Time.now(), "lamp", "world")
        time.sleep(0.05)
    assert buffer.transform(pose, "world").pose.position.z == pytest.approx(1.0)
    import moveit_commander

    assert tf.transformations.quaternion_from_euler(0, 0, 0)[3] == 1.0 and moveit_commander.conversions


def test_static_transforms_are_all_there_for_a_later_listener(rospy):
    import tf2_ros
    from geometry_msgs.msg import TransformStamped

    broadcaster = tf2_ros.StaticTransformBroadcaster()
    for i, child in enumerate(("shelf", "drawer")):
        transform = TransformStamped(child_frame_id=child)
        transform.header.frame_id, transform.transform.rotation.w = "world", 1.0
        transform.transform.translation.x = float(i)
        broadcaster.sendTransform(transform)
    buffer = tf2_ros.Buffer()
    tf2_ros.TransformListener(buffer)
    found = buffer.lookup_transform("shelf", "drawer", rospy.Time(0), rospy.Duration(5))
    assert found.transform.translation.x == 1.0
