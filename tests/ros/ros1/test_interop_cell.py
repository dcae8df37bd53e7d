"""A cell in a real ROS 1 graph: Debian's rosmaster, actionlib and rospy drive it."""

from __future__ import annotations

import os
import shutil
import struct
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from tests.ros.ros1.conftest import eventually
from tests.ros.ros1.debian import Debian, missing

import armcell
from armcell.ros import Bus, schema
from armcell.ros.ros1 import Ros1Graph, Ros1Settings

pytestmark = [pytest.mark.interop, pytest.mark.slow]
S = schema()
CELL = "panda_table"

FOLLOW = """
import sys; sys.path.insert(0, ".")
import actionlib, json, ours, rospy
from sensor_msgs.msg import JointState
rospy.init_node("follower")
ours.message("control_msgs/FollowJointTrajectoryAction")
state = rospy.wait_for_message("/joint_states", JointState, timeout=200)
client = actionlib.SimpleActionClient("/panda_arm_controller/follow_joint_trajectory",
                                      ours.MADE["control_msgs/FollowJointTrajectoryAction"])
assert client.wait_for_server(rospy.Duration(20)), "no server"
Point = ours.MADE["trajectory_msgs/JointTrajectoryPoint"]
arm = [(n, q) for n, q in zip(state.name, state.position) if "finger" not in n]
def goal(shift, seconds, names=None):
    g = ours.MADE["control_msgs/FollowJointTrajectoryGoal"]()
    g.trajectory.joint_names = names or [n for n, _ in arm]
    now = rospy.wait_for_message("/joint_states", JointState)
    here = dict(zip(now.name, now.position))
    start = [here[n] for n, _ in arm]
    ends = ((0.0, start), (seconds, [start[0] + shift] + start[1:]))
    g.trajectory.points = [
        Point(positions=q, velocities=[0.0] * 7, time_from_start=rospy.Duration(t)) for t, q in ends
    ]
    return g
told = []
found = {}
before = rospy.wait_for_message("/joint_states", JointState).position[0]
client.send_goal(goal(0.4, 2.0), feedback_cb=told.append)
client.wait_for_result(rospy.Duration(20))
found["state"], found["code"] = client.get_state(), client.get_result().error_code
found["feedback"] = len(told)
rospy.sleep(0.3)
found["moved"] = rospy.wait_for_message("/joint_states", JointState).position[0] - before
client.send_goal(goal(-0.4, 4.0))
rospy.sleep(1.0)
client.cancel_goal()
client.wait_for_result(rospy.Duration(10))
found["cancelled"] = client.get_state()
client.send_goal_and_wait(goal(0.1, 1.0, ["nonsense"] * 7), rospy.Duration(10))
found["unknown joint"] = [client.get_state(), client.get_result().error_code]
def transitions(name, kind, refused):
    # The states of actionlib's own state machine for a goal.
    plain, seen, over = actionlib.ActionClient(name, ours.message(kind)), [], []
    assert plain.wait_for_server(rospy.Duration(20)), name
    def changed(handle):
        seen.append(int(handle.get_comm_state()))
        if handle.get_comm_state() == actionlib.CommState.DONE:
            over.append(int(handle.get_terminal_state()))
    handle = plain.send_goal(refused, changed)
    while not over and not rospy.is_shutdown():
        rospy.sleep(0.02)
    return seen, over[0]
wrong = goal(0.1, 1.0)
for p in wrong.trajectory.points:
    p.positions = [q + 0.2 for q in p.positions]
closing = ours.message("control_msgs/GripperCommandGoal")()
closing.command.position = float("nan")
ACTIVE = actionlib.CommState.ACTIVE
for what, refused in (("joint", goal(0.1, 1.0, ["nonsense"] * 7)), ("start", wrong)):
    seen, end = transitions("/panda_arm_controller/follow_joint_trajectory",
                            "control_msgs/FollowJointTrajectoryAction", refused)
    found["refused " + what] = [ACTIVE in seen, end]
hand = [n for n, _ in rospy.get_published_topics() if n.endswith("/gripper_cmd/status")][0]
seen, end = transitions(hand[:-len("/status")], "control_msgs/GripperCommandAction", closing)
found["refused hand"] = [ACTIVE in seen, end]
stamps = [rospy.wait_for_message("/joint_states", JointState).header.stamp for _ in range(5)]
found["stamps grow"] = all(b > a for a, b in zip(stamps, stamps[1:]))
print(json.dumps(found))
"""

# What a stock moveit_commander does when it starts, plans, executes, edits the scene and stops.
COMMANDER = """
import sys; sys.path.insert(0, ".")
import actionlib, json, math, ours, rospy
from sensor_msgs.msg import JointState
from std_msgs.msg import String
rospy.init_node("move_group_commander_wrappers")
msg = lambda name: ours.message("moveit_msgs/" + name)
found = {"urdf": rospy.get_param("/robot_description")[:6],
         "srdf": "panda_arm" in rospy.get_param("/robot_description_semantic"),
         "scaling": rospy.get_param("/robot_description_planning/default_velocity_scaling_factor")}
clients = {}
ACTIONS = {"move_group": "MoveGroup", "execute_trajectory": "ExecuteTrajectory", "pickup": "Pickup",
           "place": "Place"}
for name, kind in ACTIONS.items():
    clients[name] = actionlib.SimpleActionClient("/" + name, msg(kind + "Action"))
    assert clients[name].wait_for_server(rospy.Duration(20)), name
def service(name, kind, **fields):
    rospy.wait_for_service(name, timeout=20)
    cls = ours.service("moveit_msgs/" + kind)
    cls._md5sum = MD5[kind]
    return rospy.ServiceProxy(name, cls)(cls._request_class(**fields))
MD5 = json.load(open("md5.json"))
scene = service("/get_planning_scene", "GetPlanningScene").scene
found["world"] = sorted(o.id for o in scene.world.collision_objects)
# A box is added as PlanningSceneInterface does.
box = msg("CollisionObject")(id="box", operation=0)
box.header.frame_id = "world"
box.primitives = [ours.message("shape_msgs/SolidPrimitive")(type=1, dimensions=[0.1, 0.1, 0.3])]
pose = ours.message("geometry_msgs/Pose")()
pose.position.x, pose.position.y, pose.position.z, pose.orientation.w = 0.4, -0.45, 0.15, 1.0
box.primitive_poses = [pose]
diff = msg("PlanningScene")(is_diff=True)
diff.robot_state.is_diff = True
diff.world.collision_objects = [box]
found["applied"] = service("/apply_planning_scene", "ApplyPlanningScene", scene=diff).success
scene = service("/get_planning_scene", "GetPlanningScene").scene
found["box there"] = "box" in [o.id for o in scene.world.collision_objects]
state = rospy.wait_for_message("/joint_states", JointState, timeout=10)
now = dict(zip(state.name, state.position))
names = [n for n in state.name if "finger" not in n]
def goal(shifts, plan_only, group="panda_arm", planner=""):
    g = msg("MoveGroupGoal")()
    r = g.request
    r.group_name, r.num_planning_attempts, r.allowed_planning_time, r.planner_id = group, 1, 5.0, planner
    r.max_velocity_scaling_factor = r.max_acceleration_scaling_factor = 0.5
    r.start_state.is_diff = True
    joints = [msg("JointConstraint")(n, now[n] + shifts.get(n, 0.0), 1e-4, 1e-4, 1.0) for n in names]
    r.goal_constraints = [msg("Constraints")(joint_constraints=joints)]
    g.planning_options.plan_only = plan_only
    g.planning_options.planning_scene_diff.is_diff = True
    g.planning_options.planning_scene_diff.robot_state.is_diff = True
    return g
def send(name, g, seconds=60):
    clients[name].send_goal(g)
    assert clients[name].wait_for_result(rospy.Duration(seconds)), name
    result = clients[name].get_result()
    return clients[name].get_state(), result.error_code.val, result
state_, code, result = send("move_group", goal({"panda_joint1": 0.5}, True))
found["plan"] = [state_, code, len(result.planned_trajectory.joint_trajectory.points) > 2]
execute = msg("ExecuteTrajectoryGoal")(trajectory=result.planned_trajectory)
found["execute"] = list(send("execute_trajectory", execute)[:2])
now["panda_joint1"] += 0.5
found["move"] = list(send("move_group", goal({"panda_joint1": -0.5}, False))[:2])
now["panda_joint1"] -= 0.5
for point in execute.trajectory.joint_trajectory.points:
    point.positions = [q + 0.3 for q in point.positions]
found["wrong start"] = list(send("execute_trajectory", execute)[:2])
found["unknown group"] = list(send("move_group", goal({}, True, "nonsense"))[:2])
# group.stop() is a word on a topic.
stop = rospy.Publisher("/trajectory_execution_event", String, queue_size=1)
slow = goal({"panda_joint1": 1.2}, False)
slow.request.max_velocity_scaling_factor = 0.1
clients["move_group"].send_goal(slow)
rospy.sleep(2.0)
stop.publish("stop")
clients["move_group"].wait_for_result(rospy.Duration(10))
found["stopped"] = [clients["move_group"].get_state(), clients["move_group"].get_result().error_code.val]
ik = msg("PositionIKRequest")(group_name="panda_arm")
ik.pose_stamped.header.frame_id = "world"
p = ik.pose_stamped.pose
p.position.x, p.position.y, p.position.z, p.orientation.x = 0.4, 0.1, 0.4, 1.0
answer = service("/compute_ik", "GetPositionIK", ik_request=ik)
found["ik"] = [answer.error_code.val, len(answer.solution.joint_state.name)]
planners = service("/query_planner_interface", "QueryPlannerInterfaces").planner_interfaces
found["planners"] = [d.name for d in planners]
print(json.dumps(found))
"""

GRASP = """
import json, rospy
from geometry_msgs.msg import PoseStamped
from std_srvs.srv import Trigger
rospy.init_node("button")
before = rospy.wait_for_message("/object_pose", PoseStamped, timeout=200).pose.position.z
rospy.wait_for_service("/grasp", timeout=120)
answer = rospy.ServiceProxy("/grasp", Trigger)()
after = rospy.wait_for_message("/object_pose", PoseStamped, timeout=10).pose.position.z
print(json.dumps([answer.success, answer.message, after - before]))
"""


RVIZ = """
Visualization Manager:
  Displays:
    - {Class: rviz/RobotModel, Enabled: true, Name: RobotModel, Robot Description: robot_description}
    - {Class: rviz/TF, Enabled: true, Name: TF, Show Names: false, Show Axes: false, Show Arrows: false}
  Enabled: true
  Global Options: {Background Color: 48; 48; 48, Fixed Frame: world, Frame Rate: 5}
  Views:
    Current: {Class: rviz/Orbit, Distance: 2.5, Focal Point: {X: 0.3, Y: 0, Z: 0.4}, Pitch: 0.4, Yaw: 0.8}
Window Geometry: {Height: 600, Width: 800}
"""


def start(real: Debian, *arguments: str) -> subprocess.Popen:
    source = str(Path(armcell.__file__).parents[1])
    environment = {
        **os.environ, "ROS_MASTER_URI": real.uri, "ROS_IP": "127.0.0.1", "PYTHONPATH": source,
    }  # fmt: skip
    return real.start(sys.executable, "-u", "-m", "armcell", *arguments, env=environment)


@pytest.fixture(scope="module")
def graph(tmp_path_factory):
    """A graph with the real master."""
    if why := missing():
        pytest.skip(f"no real ROS 1: {why}")
    real = Debian(tmp_path_factory.mktemp("ros"))
    services = [s for s in S.services if s.startswith("moveit_msgs/")]
    (real.folder / "md5.json").write_text(
        str({s.split("/")[1]: S.md5(s) for s in services}).replace("'", '"')
    )
    real.start_master()
    yield real
    real.close()


def test_actionlib_drives_the_arm_and_the_states_come_at_30_hz(graph):
    simulator = start(graph, "sim", CELL, "--ros1")
    try:
        found = graph.rospy(FOLLOW, timeout=300)
        assert found["state"] == 3 and found["code"] == 0 and found["feedback"] > 5  # SUCCEEDED
        assert found["moved"] == pytest.approx(0.4, abs=0.01)
        assert found["cancelled"] == 2  # PREEMPTED
        assert found["unknown joint"] == [5, -2]  # REJECTED, INVALID_JOINTS
        for what in ("joint", "start", "hand"):  # never active, then REJECTED
            assert found[f"refused {what}"] == [False, 5], found
        assert found["stamps grow"]
        assert abs(graph.hz("/joint_states", 12) - 30.0) <= 0.5
    finally:
        graph.stop(simulator)


def test_what_a_stock_moveit_commander_does(graph):
    server = start(graph, "serve", CELL, "--ros1")
    try:
        with Ros1Graph(Bus(), Ros1Settings("waiter", master=graph.uri, own_master=False)) as waiter:
            assert waiter.bus.wait_for_service("/query_planner_interface", 180), graph.log(server)
        found = graph.rospy(COMMANDER, timeout=300)
    finally:
        graph.stop(server)
    assert found["urdf"] == "<robot" and found["srdf"] and found["scaling"] == 0.1
    assert {"table", "cube"} <= set(found["world"]) and found["applied"] and found["box there"]
    assert found["plan"] == [3, 1, True] and found["execute"] == [3, 1] and found["move"] == [3, 1]
    assert found["wrong start"] == [4, -4]  # ABORTED, CONTROL_FAILED
    assert found["unknown group"] == [4, -15]
    assert found["stopped"][1] == -7
    assert found["ik"][0] == 1 and found["ik"][1] >= 7
    assert found["planners"]


def test_simulator_and_planner_grasp_through_a_real_graph(graph):
    planner = start(graph, "serve", CELL, "--ros1", "--plan-only", "__name:=planner")
    simulator = start(graph, "sim", CELL, "--ros1", "--time-scale", "2")
    try:
        ok, text, lifted = graph.rospy(GRASP, timeout=400)
        assert ok, (text, graph.log(planner), graph.log(simulator))
        assert lifted > 0.15
    finally:
        for process in (planner, simulator):
            graph.stop(process)
        time.sleep(0.5)


def test_rviz_shows_the_robot(graph):
    for program in ("rviz", "Xvfb"):
        if not shutil.which(program, path="/usr/bin:/bin"):
            pytest.skip(f"{program} is not installed (apt-get install rviz xvfb)")
    (graph.folder / "shown.rviz").write_text(RVIZ)
    server = start(graph, "sim", CELL, "--ros1", "--mode", "fake", "__name:=shown")
    screen = graph.start("/usr/bin/Xvfb", "-displayfd", "1", "-screen", "0", "800x600x24", "-fbdir", ".")
    with Ros1Graph(Bus(), Ros1Settings("looker", master=graph.uri, own_master=False)) as looker:
        try:
            assert looker.bus.wait_for_service("/shown/get_loggers", 60), graph.log(server)
            assert eventually(lambda: "/robot_description" in looker.bus.parameters, 60)
            number = eventually(lambda: graph.log(screen).split())[0]
            extra = {
                "DISPLAY": f":{number}",
                "LIBGL_ALWAYS_SOFTWARE": "1",
                "XDG_RUNTIME_DIR": str(graph.folder),
            }
            rviz = graph.start("/usr/bin/rviz", "-d", "shown.rviz", env={**graph.environment, **extra})
            try:
                drawn = eventually(
                    lambda: (n := robot_pixels(graph.folder / "Xvfb_screen0")) > 1500 and n, 60
                )
                assert rviz.poll() is None and "ERROR" not in graph.log(rviz), graph.log(rviz)
                assert drawn < 60_000  # a robot, not a white window
            finally:
                graph.stop(rviz)
        finally:
            graph.stop(screen)
            graph.stop(server)


def robot_pixels(file: Path) -> int:
    """Light grey pixels in the right half of a screen, which Xvfb keeps as an XWD file."""
    data = file.read_bytes()
    head = struct.unpack(">25I", data[:100])
    height, bytes_per_line = head[5], head[12]
    pixels = np.frombuffer(data, np.uint8, height * bytes_per_line, head[0] + 12 * head[19])
    view = pixels.reshape(height, -1, 4)[70:560, 420:780, :3].astype(int)
    return int(((view.min(2) > 90) & (view.max(2) - view.min(2) < 12)).sum())
