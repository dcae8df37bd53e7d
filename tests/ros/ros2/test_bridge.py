"""A bus in a ROS 2 domain, against a plain DDS program in another process that follows rmw's conventions."""

import logging
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from tests import programs

from armcell.core import InputError
from armcell.ros import ActionClient, ActionOutcome, ActionServer, Bus, GoalState, ServiceError, schema
from armcell.ros.ros2 import DomainScope, QosProfile, Ros2Bridge, Ros2Settings

S = schema()
RIHS = Path(__file__).parent / "rihs_jazzy.txt"
TRIGGER = "std_srvs/Trigger"
GRIPPER = "control_msgs/GripperCommand"


def until(condition, timeout=5.0):
    end = time.monotonic() + timeout
    while not (found := condition()) and time.monotonic() < end:
        time.sleep(0.02)
    return found


# --- topics ---
@pytest.mark.slow
def test_topics_both_ways(bus, bridge, peer):
    peer.subscribe("rt/joint_states", "JointState")
    publisher = bus.advertise("/joint_states", "sensor_msgs/JointState")
    peer.wait_matched("rt/joint_states")
    until(lambda: bridge._out["/joint_states"]._writer.readers())
    for i in range(3):
        header = S.new("std_msgs/Header", 7, S.new("builtin_interfaces/Time", 5, 6), "base")
        names, positions = ["a", "żółw"], [float(i), -1.5]
        publisher.publish(S.new("sensor_msgs/JointState", header, names, positions, effort=[2.0]))
    first, _, last = peer.take("rt/joint_states", 3)
    assert first == {
        "header": {"stamp": {"sec": 5, "nanosec": 6}, "frame_id": "base"},
        "name": ["a", "żółw"], "position": [0.0, -1.5], "velocity": [], "effort": [2.0],
    }  # fmt: skip
    assert last["position"][0] == 2.0

    inbox = bus.subscribe("/command", "std_msgs/Float64")
    peer.advertise("rt/command", "Float64")
    peer.wait_matched("rt/command")
    for value in (0.25, float("nan")):
        peer.publish("rt/command", {"data": value})
    assert inbox.get(5).data == 0.25 and np.isnan(inbox.get(5).data)
    inbox.close()
    publisher.close()  # what the bus has no more is there no more
    peer.wait_matched("rt/joint_states", 0)
    peer.wait_matched("rt/command", 0)


def test_what_comes_in_does_not_go_out_again(bus, bridge, peer):
    """A topic that both sides publish and hear: each message arrives once."""
    publisher, inbox = bus.advertise("/chat", "std_msgs/String"), bus.subscribe("/chat", "std_msgs/String")
    peer.advertise("rt/chat", "String")
    peer.subscribe("rt/chat", "String")
    peer.wait_matched("rt/chat", 2)  # its own reader and ours
    until(lambda: bridge._out["/chat"]._writer.readers())
    publisher.publish(S.new("std_msgs/String", "ours"))
    peer.publish("rt/chat", {"data": "theirs"})
    assert sorted(m["data"] for m in peer.take("rt/chat", 3, timeout=1.0)) == ["ours", "theirs"]
    assert sorted(m.data for m in (inbox.get(2), inbox.get(2))) == ["ours", "theirs"]
    assert inbox.get(0.3) is None


def test_latched_topics_reach_those_who_come_later(bus, bridge, peer):
    with bus.advertise("/robot_description", "std_msgs/String", latch=True) as publisher:
        publisher.publish(S.new("std_msgs/String", "<robot/>"))
        peer.subscribe("rt/robot_description", "String", latched=True, depth=1)
        assert peer.take("rt/robot_description")[0]["data"] == "<robot/>"
    peer.advertise("rt/map", "String", latched=True, depth=1)
    peer.publish("rt/map", {"data": "here"})
    until(lambda: "/map" in bridge.topics())
    assert bus.subscribe("/map", "std_msgs/String").get(5).data == "here"
    late = bus.subscribe("/map", "std_msgs/String")  # the bus keeps it for its own late-comers, too
    assert late.get(5).data == "here"


def test_images_are_made_only_for_those_who_look(bus, bridge, peer):
    """A camera draws while somebody on its topic listens: the bridge does so while somebody outside does."""
    publisher = bus.advertise("/camera/points", "tf2_msgs/TFMessage")
    until(lambda: "/camera/points" in bridge._out)
    assert not publisher.subscribers
    peer.subscribe("rt/camera/points", "TFMessage", reliable=False)
    assert until(lambda: publisher.subscribers)
    publisher.publish(S.new("tf2_msgs/TFMessage"))
    assert peer.take("rt/camera/points") == [{"transforms": []}]
    peer.drop("rt/camera/points")
    assert until(lambda: not publisher.subscribers)


def test_best_effort_publishers_are_heard(bus, bridge, peer):
    inbox = bus.subscribe("/scan", "std_msgs/String")
    peer.advertise("rt/scan", "String", reliable=False, depth=5)
    peer.wait_matched("rt/scan")  # a reliable reader would not match
    peer.publish("rt/scan", {"data": "near"})
    assert inbox.get(5).data == "near"
    assert not bridge._in["/scan"].profile.reliable


@pytest.mark.slow
def test_a_mismatch_of_quality_is_said(bus, bridge, peer, caplog):
    with bus.advertise("/plain", "std_msgs/String"):
        peer.subscribe("rt/plain", "String", latched=True)
        said = until(lambda: [r.message for r in caplog.records if "/plain" in r.message])
        assert said and "asks for transient local durability" in said[0] and "it gets nothing" in said[0]
        assert peer.matched("rt/plain") == 0
    other = Bus()
    settings = Ros2Settings(bridge.settings.reach, "/strict", qos={"/weak": QosProfile(reliable=True)})
    peer.advertise("rt/weak", "String", reliable=False)
    with Ros2Bridge(other, settings), other.subscribe("/weak", "std_msgs/String"):
        said = until(lambda: [r.message for r in caplog.records if "/weak" in r.message])
        assert said and "does not offer reliable delivery" in said[0]


@pytest.mark.slow
def test_a_type_mismatch_is_said_once(bus, bridge, peer, caplog):
    peer.advertise("rt/mixed", "String")
    with bus.subscribe("/mixed", "std_msgs/Float64"):
        assert until(lambda: [r for r in caplog.records if "/mixed" in r.message])
        time.sleep(1.5)
        said = [r.message for r in caplog.records if "/mixed" in r.message]
        assert len(said) == 1 and "std_msgs/String, ours is std_msgs/Float64" in said[0]


def test_garbage_is_dropped_and_the_rest_goes_on(bus, bridge, peer, caplog):
    """What the library lets through our decoder refuses: neither stops the topic."""
    inbox = bus.subscribe("/chatter", "std_msgs/String")
    peer.advertise("rt/chatter", "String")
    peer.wait_matched("rt/chatter")
    rng = np.random.default_rng(4)
    for n in (4, 5, 8, 12, 100, 5000):
        peer.publish_bytes("rt/chatter", (b"\0\1\0\0" + rng.bytes(n)).hex())
    peer.publish_bytes("rt/chatter", (b"\0\1\0\0" + b"\xff\xff\xff\xff" + b"abc\0").hex())  # 4 GiB of text
    peer.publish_bytes("rt/chatter", (b"\0\1\0\0" + b"\4\0\0\0" + b"\xff\xfe\xfd\0").hex())  # no UTF-8
    peer.publish("rt/chatter", {"data": "fine"})
    while (message := inbox.get(5)) is not None and message.data != "fine":
        pass
    assert message is not None
    assert len([r for r in caplog.records if "/chatter" in r.message]) <= 1
    assert bridge.status().errors >= 1


# --- services ---
def test_services_both_ways(bus, bridge, peer):
    asked = []

    def grasp(request):
        asked.append(request)
        return S.new("std_srvs/TriggerResponse", True, "held")

    with bus.serve("/grasp", TRIGGER, grasp):
        for _ in range(2):
            answer = peer.call("/grasp", "Trigger", {})
            assert (answer["success"], answer["message"]) == (True, "held")
        assert len(asked) == 2
    peer.serve_trigger("/home", "went home")
    assert bus.wait_for_service("/home", 5)
    answer = bus.call("/home", S.new("std_srvs/TriggerRequest"))
    assert answer.success and answer.message == "went home"


def test_a_service_that_fails_is_answered(bus, bridge, peer, caplog):
    def broken(request):
        raise InputError("no gripper here")

    with bus.serve("/grasp", TRIGGER, broken):
        answer = peer.call("/grasp", "Trigger", {})
        assert (answer["success"], answer["message"]) == (False, "service /grasp: no gripper here")
        assert "no gripper here" in caplog.text


@pytest.mark.slow
def test_many_calls_at_once_get_their_own_answers(bus, bridge, peer):
    def slow(request):
        time.sleep(0.05)
        return S.new("std_srvs/TriggerResponse", True, threading.current_thread().name)

    with bus.serve("/slow", TRIGGER, slow):
        began = time.monotonic()
        numbers = [peer.call("/slow", "Trigger", {}, wait=False) for _ in range(8)]
        assert len(set(numbers)) == 8
        assert peer.answer("/slow", "Trigger", numbers[-1])["success"]
        assert time.monotonic() - began < 20.0


def test_a_server_that_has_gone_is_no_server(bus, bridge, peer):
    assert not bus.wait_for_service("/nobody", 0.1)
    with pytest.raises(ServiceError, match="unknown service"):
        bus.call("/nobody", S.new("std_srvs/TriggerRequest"))
    peer.serve_trigger("/late", "too late", delay=3.0)
    other = Bus()
    with Ros2Bridge(other, Ros2Settings(bridge.settings.reach, "/hasty", service_timeout=0.3)):
        assert other.wait_for_service("/late", 5)
        with pytest.raises(ServiceError, match="no answer from ROS 2"):
            other.call("/late", S.new("std_srvs/TriggerRequest"))
        with pytest.raises(InputError, match="takes std_srvs/TriggerRequest"):
            other.call("/late", S.new("std_srvs/EmptyRequest"))


# --- actions ---
def gripper(bus, seconds=0.5):
    """A gripper on the bus that takes a while."""

    def execute(goal):
        for i in range(10):
            if goal.cancel.wait(seconds / 10):
                return ActionOutcome(GoalState.PREEMPTED, S.new(f"{GRIPPER}Result", position=0.5), "stopped")
            goal.feedback(S.new(f"{GRIPPER}Feedback", position=(i + 1) / 10))
        if goal.message.command.position < 0:
            return ActionOutcome(GoalState.REJECTED, S.new(f"{GRIPPER}Result"), "cannot open so far")
        result = S.new(f"{GRIPPER}Result", position=goal.message.command.position, reached_goal=True)
        return ActionOutcome(GoalState.SUCCEEDED, result)

    return ActionServer(bus, "/hand/gripper_cmd", GRIPPER, execute)


def send(peer, number, position):
    goal_id = {"uuid": [number] * 16}
    request = {"goal_id": goal_id, "goal": {"command": {"position": position}}}
    answer = peer.call("/hand/gripper_cmd/_action/send_goal", "GripperSendGoal", request)
    return goal_id, answer["accepted"]


def result(peer, goal_id):
    return peer.call("/hand/gripper_cmd/_action/get_result", "GripperGetResult", {"goal_id": goal_id})


@pytest.mark.slow
def test_an_action_of_the_bus_for_a_ros2_client(bus, bridge, peer):
    with gripper(bus):
        peer.subscribe("rt/hand/gripper_cmd/_action/feedback", "GripperFeedbackMessage")
        peer.subscribe("rt/hand/gripper_cmd/_action/status", "GoalStatusArray", latched=True, depth=1)
        peer.wait_matched("rt/hand/gripper_cmd/_action/feedback")
        goal_id, accepted = send(peer, 7, 0.04)
        assert accepted
        assert not send(peer, 7, 0.04)[1]  # a goal is taken once
        ended = result(peer, goal_id)  # waits until it is over
        assert ended["status"] == 4
        assert ended["result"]["position"] == 0.04 and ended["result"]["reached_goal"]
        feedback = peer.take("rt/hand/gripper_cmd/_action/feedback", 10)
        assert [round(f["feedback"]["position"], 3) for f in feedback] == [i / 10 for i in range(1, 11)]
        assert {tuple(f["goal_id"]["uuid"]) for f in feedback} == {(7,) * 16}
        statuses = peer.take("rt/hand/gripper_cmd/_action/status", 1)
        assert statuses[-1]["status_list"][-1]["status"] == 4
        assert result(peer, goal_id)["status"] == 4  # it is kept
        assert result(peer, {"uuid": [9] * 16})["status"] == 0  # unknown


@pytest.mark.slow
def test_every_endpoint_carries_its_type_hash(bus, bridge, peer):
    """ROS 2 nodes warn of an endpoint without user data, and compare services and actions by the hashes."""
    with (
        ActionServer(bus, "/hashed", GRIPPER, lambda goal: ActionOutcome(GoalState.SUCCEEDED, goal.message)),
        bus.serve("/hashed_service", TRIGGER, lambda request: request),
        bus.advertise("/hashed_topic", "std_msgs/String"),
        bus.subscribe("/heard_topic", "std_msgs/String"),
    ):
        wanted = {
            "rq/hashed/_action/send_goalRequest": "GripperCommand_SendGoal_Request",
            "rr/hashed/_action/send_goalReply": "GripperCommand_SendGoal_Response",
            "rr/hashed/_action/get_resultReply": "GripperCommand_GetResult_Response",
            "rt/hashed/_action/feedback": "GripperCommand_FeedbackMessage",
            "rt/hashed/_action/status": "GoalStatusArray",
            "rq/hashed_serviceRequest": "Trigger_Request",
            "rr/hashed_serviceReply": "Trigger_Response",
            "rt/hashed_topic": "String",
            "rt/heard_topic": "String",
            "ros_discovery_info": "ParticipantEntitiesInfo",
        }
        assert until(lambda: wanted.keys() <= {found[0] for found in peer.found()})
        ours = [found for found in peer.found() if "hashed" in found[0] or found[0] in wanted]
    recorded = dict(line.split() for line in RIHS.read_text().splitlines()[1:])
    for topic, type_name, user, _ in ours:
        hash_ = user.rpartition("typehash=RIHS01_")[2].rstrip(";")
        assert len(hash_) == 64, (topic, user)
        full = type_name.replace("::dds_::", "::").replace("::", "/").removesuffix("_")
        assert wanted.get(topic, "") in full
        assert recorded.get(full, hash_) == hash_
    assert sum("GripperCommand" in type_name for _, type_name, _, _ in ours) >= 5


@pytest.mark.slow
def test_fields_that_only_ros2_has_cross_the_bridge(bus, bridge, peer):
    """The controllers that a client names come in; the reason of a failure goes out."""
    asked, name = [], "moveit_msgs/ExecuteTrajectory"

    def refuse(goal):
        asked.append(goal.message.controller_names)
        code = S.new("moveit_msgs/MoveItErrorCodes", -4)
        return ActionOutcome(GoalState.ABORTED, S.new(f"{name}Result", code), "the arm is elsewhere")

    with ActionServer(bus, "/execute_trajectory", name, refuse):
        goal_id = {"uuid": [5] * 16}
        goal = {"goal_id": goal_id, "goal": {"controller_names": ["left_controller"]}}
        answer = peer.call("/execute_trajectory/_action/send_goal", "ExecuteSendGoal", goal)
        assert answer["accepted"]
        ended = peer.call("/execute_trajectory/_action/get_result", "ExecuteGetResult", {"goal_id": goal_id})
    assert asked == [["left_controller"]] and ended["status"] == 6
    code = {"val": -4, "message": "the arm is elsewhere", "source": "armcell"}
    assert ended["result"] == {"error_code": code}


@pytest.mark.slow
def test_an_action_of_the_bus_is_cancelled_and_aborted(bus, bridge, peer):
    with gripper(bus, 3.0):
        cancel = "/hand/gripper_cmd/_action/cancel_goal"
        goal_id, _ = send(peer, 1, 0.04)
        info = {"goal_info": {"goal_id": {"uuid": [2] * 16}}}
        assert peer.call(cancel, "CancelGoal", info)["return_code"] == 2  # no such goal
        answer = peer.call(cancel, "CancelGoal", {"goal_info": {"goal_id": goal_id}})
        assert answer["return_code"] == 0
        assert [g["goal_id"] for g in answer["goals_canceling"]] == [goal_id]
        ended = result(peer, goal_id)
        assert ended["status"] == 5 and ended["result"]["position"] == 0.5
        assert (
            peer.call(cancel, "CancelGoal", {"goal_info": {"goal_id": goal_id}})["return_code"] == 3
        )  # over
        assert peer.call(cancel, "CancelGoal", {})["return_code"] == 1  # nothing runs
        first, _ = send(peer, 3, 0.04)
        second, _ = send(peer, 4, 0.04)  # takes over: the first was not cancelled by its client
        assert result(peer, first)["status"] == 6
        assert peer.call(cancel, "CancelGoal", {})["return_code"] == 0  # all
        assert result(peer, second)["status"] == 5
    with gripper(bus, 0.1):
        until(lambda: "/hand/gripper_cmd" in bridge._actions)
        goal_id, accepted = send(peer, 5, -1.0)
        assert accepted and result(peer, goal_id)["status"] == 6  # rejected by its server later on


def test_an_action_of_ros2_for_a_client_on_the_bus(bus, bridge, peer):
    peer.serve_gripper("/far/gripper_cmd", 0.5)
    with ActionClient(bus, "/far/gripper_cmd", GRIPPER) as client:
        assert until(lambda: bridge._reaching)
        goal, told = S.new(f"{GRIPPER}Goal"), []
        goal.command.position = 0.03
        sent = client.send_goal(goal, told.append)
        assert sent.wait(10) and sent.state is GoalState.SUCCEEDED
        assert sent.result.position == 0.03 and sent.result.reached_goal
        assert 8 <= len(told) <= 10 and told[-1].position == 1.0
        sent = client.send_goal(goal)
        time.sleep(0.2)
        sent.cancel()
        assert sent.wait(10) and sent.state is GoalState.PREEMPTED and not sent.result.reached_goal
    assert until(lambda: not bridge._reaching)


@pytest.mark.slow
def test_move_group_has_moveit_2s_name_outside(bus, bridge, peer):
    """And a client on another bus, which calls it as ROS 1 does, finds it."""
    MOVE, other = "moveit_msgs/MoveGroup", Bus()

    def execute(goal):
        result = S.new(f"{MOVE}Result", error_code=S.new("moveit_msgs/MoveItErrorCodes", 1))
        return ActionOutcome(GoalState.SUCCEEDED, result)

    with (
        ActionServer(bus, "/move_group", MOVE, execute),
        Ros2Bridge(other, Ros2Settings(bridge.settings.reach, "/asking")) as asking,
        ActionClient(other, "/move_group", MOVE) as client,
    ):
        assert client.wait_for_server(10)
        sent = client.send_goal(S.new(f"{MOVE}Goal"))
        assert sent.wait(10) and sent.state is GoalState.SUCCEEDED and sent.result.error_code.val == 1
        assert asking.services()["/move_action/_action/send_goal"] == f"{MOVE}_SendGoal"
        assert "rq/move_action/_action/send_goalRequest" in {found[0] for found in peer.found()}


@pytest.mark.slow
def test_an_action_server_that_dies_aborts_the_goal(bus, bridge, mortal):
    mortal.serve_gripper("/mortal/gripper_cmd", 60.0)
    with ActionClient(bus, "/mortal/gripper_cmd", GRIPPER) as client:
        until(lambda: bridge._reaching)
        sent = client.send_goal(S.new(f"{GRIPPER}Goal"))
        assert not sent.wait(1.0)
        mortal.process.kill()
        assert sent.wait(30) and sent.state is GoalState.ABORTED and "went away" in sent.text
    assert until(lambda: not bridge._reaching)


# --- who is there ---
@pytest.mark.slow
def test_discovery_info_names_our_node_and_its_endpoints(bus, bridge, peer):
    publisher = bus.advertise("/joint_states", "sensor_msgs/JointState")
    peer.subscribe("ros_discovery_info", "ParticipantEntitiesInfo", latched=True, depth=0)

    told = set()  # our node's writers, as ros_discovery_info has them

    def listed():
        """Our writer of the topic, once discovery and the node's entry both have it."""
        for info in peer.take("ros_discovery_info", 1, timeout=0.2):
            node = info["node_entities_info_seq"][0]
            assert (node["node_namespace"], node["node_name"]) == ("/", "armcell")
            told.update(bytes(g["data"]).hex() for g in node["writer_gid_seq"])
        return [found[1:] for found in peer.found() if found[0] == "rt/joint_states" and found[3] in told]

    type_name, user, _ = until(listed)[0]
    assert type_name == "sensor_msgs::msg::dds_::JointState_"
    # Jazzy's own hash of the type, from rosidl's generated code
    assert user == "typehash=RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e;"
    publisher.close()


@pytest.mark.slow
def test_other_nodes_are_known(bridge, mortal):
    mortal.node("/lab", "planner")
    assert bridge.wait_for_node("/lab/planner", 5)
    assert bridge.status().nodes == ("/lab/planner",)
    mortal.close()
    assert until(lambda: not bridge.nodes())


def test_parameters_as_ros2_param_asks_for_them(bus, bridge, peer):
    bus.parameters.set("/robot_description", "<robot/>")
    bus.parameters.set("/arm", {"speed": 0.5, "joints": ["a", "b"], "retries": 3, "gains": [1, 2.5]})
    names = peer.call("/armcell/list_parameters", "ListParameters", {})["result"]["names"]
    assert names == [
        "arm.gains",
        "arm.joints",
        "arm.retries",
        "arm.speed",
        "robot_description",
        "use_sim_time",
    ]
    below = peer.call("/armcell/list_parameters", "ListParameters", {"prefixes": ["arm"]})["result"]
    assert below["names"] == names[:4] and below["prefixes"] == ["arm"]
    asked = {"names": ["arm.speed", "arm.joints", "arm.gains", "arm.retries", "use_sim_time", "none"]}
    values = peer.call("/armcell/get_parameters", "GetParameters", asked)["values"]
    assert [v["type"] for v in values] == [3, 9, 8, 2, 1, 0]
    assert values[0]["double_value"] == 0.5 and values[1]["string_array_value"] == ["a", "b"]
    assert values[2]["double_array_value"] == [1.0, 2.5] and values[3]["integer_value"] == 3
    new = [{"name": "arm.speed", "value": {"type": 3, "double_value": 0.25}},
           {"name": "use_sim_time", "value": {"type": 1, "bool_value": True}}]  # fmt: skip
    done = peer.call("/armcell/set_parameters", "SetParameters", {"parameters": new})["results"]
    assert [d["successful"] for d in done] == [True, False] and "clock" in done[1]["reason"]
    assert bus.parameters.get("/arm/speed") == 0.25


def test_descriptions_are_topics_too(bus, bridge, peer):
    """RViz and MoveIt 2's clients look for the robot on latched topics."""
    bus.parameters.set("/robot_description_semantic", "<robot name='semantic'/>")
    peer.subscribe("rt/robot_description_semantic", "String", latched=True, depth=1)
    assert peer.take("rt/robot_description_semantic")[0]["data"] == "<robot name='semantic'/>"
    bus.parameters.set("/robot_description_semantic", "<robot/>")
    assert peer.take("rt/robot_description_semantic")[0]["data"] == "<robot/>"


@pytest.mark.slow
def test_a_client_that_dies_while_it_waits_holds_nobody_up(bus, bridge, peer, mortal):
    def slow(request):
        time.sleep(1.0)
        return S.new("std_srvs/TriggerResponse", True, "done")

    with bus.serve("/patient", TRIGGER, slow):
        for _ in range(20):  # more than are answered at a time
            mortal.call("/patient", "Trigger", {}, wait=False)
        mortal.process.kill()
        assert peer.call("/patient", "Trigger", {}, timeout=30.0)["success"]


# --- beginning and end ---
@pytest.mark.slow
def test_nothing_is_left_behind(reach, bus):
    before = set(threading.enumerate())
    for _ in range(2):
        with Ros2Bridge(bus, Ros2Settings(reach)) as bridge, gripper(bus):
            bus.subscribe("/a", "std_msgs/String")
            until(lambda: bridge.status().actions)
            bridge.close()
            bridge.close()  # twice is fine
    until(lambda: not set(threading.enumerate()) - before - subscriptions())
    assert not [t for t in set(threading.enumerate()) - before if "ros2" in t.name]
    assert bus._finders == []
    assert [t.name for t in bus.topics() if t.name != "/a"] == []


def subscriptions():
    return {t for t in threading.enumerate() if t.name.startswith(("sub", "status", "goal"))}


@pytest.mark.slow
def test_a_program_that_forgets_to_close_ends_all_the_same(reach):
    script = f"""
from armcell.ros import Bus, DomainScope, Ros2Bridge, Ros2Settings
bus = Bus()
bus.subscribe("/a", "std_msgs/String")
Ros2Bridge(bus, Ros2Settings(DomainScope({reach.domain}, config={reach.config!r}))).start()
raise SystemExit(3)
"""
    ended = programs.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60)
    assert (ended.returncode, ended.stderr) == (3, "")


@pytest.mark.slow
def test_a_domain_that_is_joined_differently_already(reach, bus):
    with Ros2Bridge(bus, Ros2Settings(reach)):
        other = DomainScope(reach.domain, "SUBNET", config=reach.config)
        with pytest.raises(InputError, match="another reach already"):
            Ros2Bridge(Bus(), Ros2Settings(other)).start()
    with Ros2Bridge(Bus(), Ros2Settings(other)):  # the first one has left
        pass


def test_without_the_extra_it_says_what_to_install(monkeypatch, bus):
    import sys

    from armcell.core import MissingExtraError
    from armcell.ros.ros2.dds import library

    library.cache_clear()
    monkeypatch.setitem(sys.modules, "cyclonedds", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'armcell\[ros2\]'"):
        Ros2Bridge(bus, Ros2Settings(DomainScope(3))).start()
    library.cache_clear()


@pytest.mark.slow
def test_wrong_settings(bus):
    with pytest.raises(InputError, match="unknown ROS 2 distribution 'noetic'"):
        Ros2Bridge(bus, Ros2Settings(DomainScope(3), distro="noetic")).start()
    for domain in (-1, 233):
        with pytest.raises(InputError, match="0 to 232"):
            DomainScope(domain)
    with pytest.raises(InputError, match="LOCALHOST"):
        DomainScope(0, "NEAR")
    with pytest.raises(InputError, match="no topic or service name"):
        Ros2Settings(DomainScope(3), node="my node")
    logging.getLogger("armcell").debug("nothing was started")
