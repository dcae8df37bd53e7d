"""`--ros1` on the command line, with our own master: no ROS is needed."""

from __future__ import annotations

import signal
import socket
import textwrap
import time

import pytest
from tests.cli.helpers import call, start

from armcell.ros import Bus, Ros1Graph, Ros1Settings, schema

S = schema()


@pytest.fixture
def master(monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as free:
        uri = f"http://127.0.0.1:{free.getsockname()[1]}"
    monkeypatch.setenv("ROS_MASTER_URI", uri)
    for name in ("ROS_IP", "ROS_HOSTNAME", "ROS_NAMESPACE"):
        monkeypatch.delenv(name, raising=False)
    return uri


def wait_until(what, seconds=90):
    end = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < end
        time.sleep(0.2)


@pytest.mark.slow
def test_serve_topics_and_services(master, capsys):
    server = start(
        "serve", "panda_pick", "--ros1", "--mode", "fake", "__name:=cell", "joint_states:=/arm/joints"
    )
    try:
        assert server.stdout is not None
        assert server.stdout.readline() == f"ROS 1: node /cell at its own master, {master}/; Ctrl-C ends it\n"
        listed = call(capsys, "topic", "list", "--ros1")
        assert "/arm/joints  sensor_msgs/JointState" in listed.out and "/joint_states" not in listed.out
        assert "frame_id: world" in call(capsys, "topic", "echo", "/object_pose", "-n", "1", "--ros1").out
        said = call(capsys, "topic", "hz", "/arm/joints", "-n", "60", "--ros1")
        assert 28 < float(said.out.splitlines()[-1].split()[0]) < 32
        said = call(capsys, "topic", "pub", "/gripper_command", "std_msgs/Float64", "{data: 0.01}", "--ros1")
        assert said.status == 0 and "1 published" in said.err
        wait_until(
            lambda: "- 0.005" in call(capsys, "topic", "echo", "/arm/joints", "-n", "1", "--ros1").out, 20
        )
        fk = ("service", "call", "/compute_fk", "moveit_msgs/GetPositionFK", "{fk_link_names: [panda_hand]}")
        said = call(capsys, *fk, "--ros1")
        assert said.status == 0 and "val: 1\n" in said.out
        said = call(capsys, "service", "call", "/nobody", "std_srvs/Trigger", "--ros1")
        assert said.status == 1 and "unknown service '/nobody'" in said.err
        assert "did you mean" in call(capsys, "topic", "echo", "/object_poses", "--ros1").err
        # A second one of that name takes it over: the first says so and ends.
        with Ros1Graph(Bus(), Ros1Settings("cell", master=master, own_master=False)):
            _, err = server.communicate(timeout=30)
        assert server.returncode == 1
        # Told by the master, or seen at the next look at it: whichever is first.
        assert "the ROS 1 node has to end" in err
        assert "new node registered with same name" in err or "another node has the name /cell" in err
    finally:
        if server.poll() is None:
            server.send_signal(signal.SIGINT)
            server.communicate(timeout=30)


@pytest.mark.long
def test_a_script_and_its_cell_in_a_graph(master, tmp_path):
    script = tmp_path / "script.py"
    script.write_text(
        textwrap.dedent("""
        import actionlib, rospy
        from control_msgs.msg import GripperCommandAction, GripperCommandGoal
        from std_msgs.msg import String
        from std_srvs.srv import SetBool
        rospy.init_node("mine")
        word = rospy.wait_for_message("/word", String, timeout=30)
        rospy.wait_for_service("/theirs", timeout=10)
        answer = rospy.ServiceProxy("/theirs", SetBool)(True)
        client = actionlib.SimpleActionClient("/outside", GripperCommandAction)
        assert client.wait_for_server(rospy.Duration(20))
        state = client.send_goal_and_wait(GripperCommandGoal(), rospy.Duration(10))
        rospy.loginfo("%s %s %s %s", word.data, answer.message, rospy.get_param("/speed"), state)
        rospy.Publisher("/said", String, latch=True, queue_size=1).publish(str(rospy.get_param("~gain")))
        assert ["/word", "std_msgs/String"] in rospy.get_published_topics()
        rospy.sleep(1.0)
        """)
    )
    from armcell.ros import ActionOutcome, ActionServer, GoalState

    bus = Bus()
    bus.advertise("/word", "std_msgs/String", latch=True).publish(S.new("std_msgs/String", "from outside"))
    bus.serve("/theirs", "std_srvs/SetBool", lambda r: S.new("std_srvs/SetBoolResponse", r.data, "served"))
    bus.parameters.set("/speed", 0.5)
    kind = "control_msgs/GripperCommand"
    done = ActionOutcome(GoalState.SUCCEEDED, S.new(f"{kind}Result"))
    said = bus.subscribe("/said", "std_msgs/String")
    lines = bus.subscribe("/rosout", "rosgraph_msgs/Log", queue_size=200)
    with (
        ActionServer(bus, "/outside", kind, lambda _: done),
        Ros1Graph(bus, Ros1Settings("outside", master=master, own_master=True)),
    ):
        bus.parameters.set("/mine/gain", 3)
        options = ("--mode", "fake", "--headless", "--ros1", "--no-own-master")
        process = start("run", script, "--cell", "panda_table", *options)
        try:
            joints = bus.subscribe("/joint_states", "sensor_msgs/JointState", queue_size=1)
            assert joints.get(90) is not None  # the script's cell is in the graph, too
            assert said.get(30).data == "3"
        finally:
            _, err = process.communicate(timeout=60)
        assert process.returncode == 0, err
        assert "from outside served 0.5 3" in err and "(ROS 1 node)" in err
        heard = []
        while (line := lines.get(0.3)) is not None:
            heard.append(line.msg)
        assert "from outside served 0.5 3" in heard


def test_what_is_wrong_is_said(master, capsys):
    assert "nothing to serve" in call(capsys, "serve", "panda_pick").err
    unity = ("serve", "panda_pick", "--unity", "--port", "0")
    assert "add --ros1" in call(capsys, *unity, "__name:=b").err
    assert "goes with --ros1" in call(capsys, *unity, "--own-master").err
    assert "'a' is not a remapping (write FROM:=TO)" in call(capsys, *unity, "--remap", "a").err
    assert "either --connect HOST:PORT" in call(capsys, "sim", "panda_pick").err
    said = call(capsys, "serve", "panda_pick", "--ros1", "--no-own-master")
    assert said.status == 1 and "no ROS master" in said.err and "start roscore" in said.err
    assert "is not a remapping" in call(capsys, "serve", "panda_pick", "nonsense", "--ros1").err
    assert call(capsys, "run", "panda_pick", "--ros1").status == 2
    assert "no ROS master" in call(capsys, "topic", "list", "--ros1").err
