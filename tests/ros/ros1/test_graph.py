"""Two buses, joined by nothing but a ROS 1 graph."""

from __future__ import annotations

import socket
import threading
import time

import numpy as np
import pytest
from tests.ros.helpers import random_message
from tests.ros.ros1.conftest import eventually

from armcell.core import InputError, UnknownNameError
from armcell.ros import ActionClient, ActionOutcome, ActionServer, Bus, GoalState, ServiceError, schema
from armcell.ros.ros1 import Ros1Graph, Ros1Settings

S = schema()
STRING = "std_msgs/String"


def text(value):
    return S.new(STRING, value)


def test_messages_go_both_ways_and_do_not_come_back(joined):
    a, b = joined("a"), joined("b")
    assert a.master is not None and b.master is None
    there = b.bus.subscribe("/down", STRING)
    back = a.bus.subscribe("/up", STRING)
    own = a.bus.subscribe("/down", STRING)
    down = a.bus.advertise("/down", STRING)
    up = b.bus.advertise("/up", STRING)
    eventually(lambda: down.subscribers == 2 and up.subscribers == 1)
    for n in range(50):
        down.publish(text(f"down {n}"))
        up.publish(text(f"up {n}"))
        time.sleep(0.002)
    for inbox, word in ((there, "down"), (back, "up"), (own, "down")):
        eventually(lambda inbox=inbox: inbox.dropped == 40)  # its queue holds ten; each came once
        assert [inbox.get(1).data for _ in range(10)] == [f"{word} {n}" for n in range(40, 50)]
    assert a.status().peers == ("/b",) and a.status().connections == 3  # /rosout is heard by the aggregator


def test_every_message_arrives_in_order_where_the_queue_is_long_enough(joined):
    a, b = joined("a"), joined("b")
    inbox = b.bus.subscribe("/n", "std_msgs/Int32", queue_size=2000)
    out = a.bus.advertise("/n", "std_msgs/Int32")
    eventually(lambda: out.subscribers)
    for n in range(1000):
        out.publish(S.new("std_msgs/Int32", n))
        if n % 50 == 0:
            time.sleep(0.002)
    assert [inbox.get(5).data for _ in range(1000)] == list(range(1000))


@pytest.mark.parametrize(
    "name", ["sensor_msgs/PointCloud2", "moveit_msgs/PlanningScene", "tf2_msgs/TFMessage"]
)
def test_messages_arrive_as_they_were(joined, name):
    a, b = joined("a"), joined("b")
    inbox = b.bus.subscribe("/m", name)
    message = random_message(S, name, np.random.default_rng(1))
    a.bus.advertise("/m", name, latch=True).publish(message)
    got = inbox.get(5)
    for m in (got, message):
        if hasattr(m, "header"):
            m.header.seq = 0  # counted on the way
    assert got == message


def test_headers_are_counted(joined):
    a, b = joined("a"), joined("b")
    inbox = b.bus.subscribe("/j", "sensor_msgs/JointState")
    out = a.bus.advertise("/j", "sensor_msgs/JointState")
    eventually(lambda: out.subscribers)
    for _ in range(3):
        out.publish(S.new("sensor_msgs/JointState", name=["x"]))
    assert [inbox.get(2).header.seq for _ in range(3)] == [1, 2, 3]


def test_every_publishers_latched_message_reaches_who_comes_later(joined):
    """As static transforms of several nodes do."""
    for name in ("a", "b", "c"):
        joined(name).bus.advertise("/tf_static", "tf2_msgs/TFMessage", latch=True).publish(
            S.new("tf2_msgs/TFMessage", [S.new("geometry_msgs/TransformStamped", child_frame_id=name)])
        )
    late = joined("late")
    inbox = late.bus.subscribe("/tf_static", "tf2_msgs/TFMessage")
    assert sorted(inbox.get(3).transforms[0].child_frame_id for _ in range(3)) == ["a", "b", "c"]
    later = late.bus.subscribe("/tf_static", "tf2_msgs/TFMessage")  # the same node, once more
    assert sorted(later.get(3).transforms[0].child_frame_id for _ in range(3)) == ["a", "b", "c"]


def test_services_of_other_nodes_are_called_by_name(joined):
    a, b = joined("a"), joined("b")

    def handler(request):
        if not request.data:
            raise InputError("no", hint="say yes")
        return S.new("std_srvs/SetBoolResponse", True, "done")

    a.bus.serve("/switch", "std_srvs/SetBool", handler)
    assert b.bus.wait_for_service("/switch", 3)
    assert b.bus.call("/switch", S.new("std_srvs/SetBoolRequest", True)).message == "done"
    with pytest.raises(ServiceError, match=r"service cannot process request.*no .*say yes"):
        b.bus.call("/switch", S.new("std_srvs/SetBoolRequest", False))
    with pytest.raises(ServiceError, match="unknown service '/none'"):
        b.bus.call("/none", S.new("std_srvs/SetBoolRequest", False))
    with pytest.raises(ServiceError, match="md5sums do not match"):
        b.bus.call("/switch", S.new("std_srvs/TriggerRequest"))
    assert not b.bus.wait_for_service("/none", 0.2)
    with b.node.service("/switch", "std_srvs/SetBool") as kept:
        assert all(kept.call(S.new("std_srvs/SetBoolRequest", True)).success for _ in range(20))
    assert b.node.service_type("/switch") == "std_srvs/SetBool"


def test_a_service_call_that_waits_ends_with_the_graph(joined):
    a, b = joined("a"), joined("b")
    go = threading.Event()
    a.bus.serve("/slow", "std_srvs/Trigger", lambda _: go.wait(20) and S.new("std_srvs/TriggerResponse"))
    b.bus.wait_for_service("/slow", 3)
    failed = []

    def call():
        try:
            b.bus.call("/slow", S.new("std_srvs/TriggerRequest"))
        except ServiceError as error:
            failed.append(str(error))

    thread = threading.Thread(target=call)
    thread.start()
    time.sleep(0.3)
    b.close()
    thread.join(3)
    go.set()
    assert failed and "gave no answer" in failed[0]


@pytest.mark.slow
def test_actions_go_along(joined):
    a, b = joined("a"), joined("b")
    kind = "control_msgs/GripperCommand"

    def execute(goal):
        for n in range(3):
            goal.feedback(S.new(f"{kind}Feedback", position=float(n)))
        if goal.message.command.position < 0:
            goal.cancel.wait(5)
            return ActionOutcome(GoalState.PREEMPTED, S.new(f"{kind}Result"), "stopped")
        return ActionOutcome(
            GoalState.SUCCEEDED, S.new(f"{kind}Result", position=goal.message.command.position)
        )

    with ActionServer(a.bus, "/grip", kind, execute), ActionClient(b.bus, "/grip", kind) as client:
        assert client.wait_for_server(5)
        told = []
        command = S.new("control_msgs/GripperCommand", position=0.04)
        sent = client.send_goal(S.new(f"{kind}Goal", command), lambda f: told.append(f.position))
        assert sent.wait(5) and sent.state is GoalState.SUCCEEDED and sent.result.position == 0.04
        assert told == [0.0, 1.0, 2.0]
        sent = client.send_goal(S.new(f"{kind}Goal", S.new("control_msgs/GripperCommand", position=-1.0)))
        eventually(lambda: sent.state is GoalState.ACTIVE)
        sent.cancel()
        assert (
            sent.wait(5)
            and sent.state is GoalState.PREEMPTED
            and sent.text == "canceled by a client: stopped"
        )


def test_parameters_are_the_graphs(joined):
    bus = Bus()
    bus.parameters.set("/robot_description", "<robot/>")
    a, b = joined("a", bus, parameters={"speed": 2}), joined("b")
    assert b.bus.parameters.get("/robot_description") == "<robot/>"
    assert b.bus.parameters.get("/a/speed") == 2
    b.bus.parameters.set("/arm", {"limits": np.array([1.0, 2.0]), "ok": True})
    assert a.bus.parameters.get("/arm/limits") == [1.0, 2.0]
    assert "/arm/ok" in a.bus.parameters and "/arm/none" not in a.bus.parameters
    a.bus.parameters.delete("/arm")
    with pytest.raises(UnknownNameError, match="parameter"):
        b.bus.parameters.get("/arm/ok")
    with pytest.raises(UnknownNameError):
        b.bus.parameters.delete("/arm")
    assert b.bus.parameters.get("/arm/ok", 7) == 7
    assert "/run_id" in a.bus.parameters.names()
    b.close()
    assert b.bus.parameters.get("/arm/ok", None) is None  # its own again
    assert a.bus.parameters.get("/")["robot_description"] == "<robot/>"


def test_what_is_there_before_we_join_is_kept_where_asked(joined):
    """A cell joins when it is ready, so its description is on its bus before that of the graph is known."""
    a = joined("a")
    a.bus.parameters.set("/robot_description", "theirs")
    bus = Bus()
    bus.parameters.set("/robot_description", "ours")
    bus.parameters.set("/robot_description_semantic", "ours")
    settings = Ros1Settings("late", master=a.settings.master, own_master=False)
    with Ros1Graph(bus, settings, keep=("/robot_description", "/nothing")):
        assert bus.parameters.get("/robot_description") == "theirs"
        assert a.bus.parameters.get("/robot_description") == "theirs"
        assert a.bus.parameters.get("/robot_description_semantic") == "ours"


def test_a_reserved_graph_opens_nothing_and_keeps_the_port(master_uri):
    port = int(master_uri.rpartition(":")[2])
    settings = Ros1Settings(master=master_uri, own_master=True)
    graph = Ros1Graph(Bus(), settings)
    graph.reserve()
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", port))
    with pytest.raises(OSError, match="in use"):
        socket.create_server(("127.0.0.1", port))
    graph.close()  # never started
    socket.create_server(("127.0.0.1", port)).close()


def test_namespace_and_remapping(joined):
    a = joined("a", namespace="/left", remap={"joint_states": "/panda/joint_states"})
    b = joined("b")
    joints = b.bus.subscribe("/panda/joint_states", "sensor_msgs/JointState")
    status = b.bus.subscribe("/left/status", STRING)
    clock = b.bus.subscribe("/clock", "rosgraph_msgs/Clock")
    a.bus.advertise("/joint_states", "sensor_msgs/JointState", latch=True).publish(
        S.new("sensor_msgs/JointState")
    )
    a.bus.advertise("/status", STRING, latch=True).publish(text("fine"))
    a.bus.advertise("/clock", "rosgraph_msgs/Clock", latch=True).publish(S.new("rosgraph_msgs/Clock"))
    assert joints.get(3) is not None and status.get(3).data == "fine" and clock.get(3) is not None
    assert a.node.name == "/left/a"
    assert b.bus.wait_for_service("/left/a/get_loggers", 3)


def test_who_publishes_the_clock_sets_the_time_of_the_graph(joined):
    a = joined("a")
    clock = a.bus.advertise("/clock", "rosgraph_msgs/Clock")
    eventually(lambda: a.bus.parameters.get("/use_sim_time", False))
    b = joined("b")
    eventually(lambda: clock.subscribers)
    clock.publish(S.new("rosgraph_msgs/Clock", S.new("builtin_interfaces/Time", 12, 500_000_000)))
    eventually(lambda: b.bus.clock.now() == 12.5)


def test_logs_and_their_levels(joined, caplog):
    import logging

    a, b = joined("a"), joined("b")
    lines = b.bus.subscribe("/rosout", "rosgraph_msgs/Log", queue_size=100)
    everybody = b.bus.subscribe("/rosout_agg", "rosgraph_msgs/Log", queue_size=100)
    eventually(lambda: sum(t.publishers for t in b.bus.topics() if t.name.startswith("/rosout")) >= 3)
    answer = b.bus.call("/a/get_loggers", S.new("roscpp/GetLoggersRequest"))
    levels = {x.name: x.level for x in answer.loggers}
    assert "armcell" in levels and set(levels.values()) <= {"debug", "info", "warn", "error", "fatal"}
    before = logging.getLogger("armcell.ros").level
    try:
        b.bus.call("/a/set_logger_level", S.new("roscpp/SetLoggerLevelRequest", "armcell.ros", "DEBUG"))
        assert logging.getLogger("armcell.ros").level == logging.DEBUG
        with pytest.raises(ServiceError, match="no logger is called"):
            b.bus.call("/a/set_logger_level", S.new("roscpp/SetLoggerLevelRequest", "x", "info"))
    finally:
        logging.getLogger("armcell.ros").setLevel(before)
    a.rosout.say("error", "too hot", "file.py", "f", 3)
    found = eventually(lambda: [m for m in iter(lambda: lines.get(0.2), None) if m.msg == "too hot"])
    assert (found[0].level, found[0].name, found[0].line) == (8, "/a", 3)
    eventually(lambda: any(m.msg == "too hot" for m in iter(lambda: everybody.get(0.2), None)))


def test_a_master_is_needed_or_started(master_uri, no_threads_left):
    graph = Ros1Graph(Bus(), Ros1Settings(master=master_uri, own_master=False))
    with pytest.raises(InputError, match="no ROS master.*start roscore"):
        graph.start()
    far = Ros1Graph(Bus(), Ros1Settings(master="http://192.0.2.1:11311", timeout=0.2))
    with pytest.raises(InputError, match="on that machine"):
        far.start()
