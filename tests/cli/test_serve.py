"""`armcell serve`, `armcell sim` and `armcell topic`, as processes that talk to each other."""

import signal
import socket
import time

import pytest
from tests.cli.helpers import call, start

from armcell.records import read_record

pytestmark = pytest.mark.slow


@pytest.fixture
def port():
    with socket.create_server(("127.0.0.1", 0)) as free:
        return free.getsockname()[1]


def wait_for_port(port, process):
    end = time.monotonic() + 60
    while time.monotonic() < end and process.poll() is None:
        try:
            socket.create_connection(("127.0.0.1", port), timeout=1).close()
            return
        except OSError:
            time.sleep(0.05)
    pytest.fail(f"nothing listens: {process.communicate(timeout=5)}")


def test_serve_topic_and_ctrl_c(port, capsys):
    server = start("serve", "panda_pick", "--unity", "--port", port, "--mode", "fake")
    try:
        wait_for_port(port, server)
        at = ("--connect", f"127.0.0.1:{port}")
        end = time.monotonic() + 60
        while "/joint_states" not in (listed := call(capsys, "topic", "list", *at)).out:
            assert time.monotonic() < end
            time.sleep(0.2)
        assert "/planned_trajectory  trajectory_msgs/JointTrajectory" in listed.out
        said = call(capsys, "topic", "echo", "/object_pose", "-n", "1", *at)
        assert "frame_id: world" in said.out
        said = call(capsys, "topic", "hz", "/joint_states", "-n", "60", *at)
        rates = [float(line.split()[0]) for line in said.out.splitlines()]
        assert 28 < rates[-1] < 32
        said = call(capsys, "topic", "pub", "/gripper_command", "std_msgs/Float64", "{data: 0.01}", *at)
        assert said.status == 0 and "1 published" in said.err
        end = time.monotonic() + 20
        while "- 0.005" not in call(capsys, "topic", "echo", "/joint_states", "-n", "1", *at).out:
            assert time.monotonic() < end
        fk = ("service", "call", "/compute_fk", "moveit_msgs/GetPositionFK")
        said = call(capsys, *fk, "{fk_link_names: [panda_hand]}", *at)
        assert said.status == 0 and "val: 1\n" in said.out and "- panda_hand\n" in said.out
        assert "val: -18\n" in call(capsys, *fk, "{fk_link_names: [tail]}", *at).out
        said = call(capsys, *fk, "{fk_link: x}", *at)
        assert said.status == 1 and "did you mean 'fk_link_names'" in said.err
        said = call(capsys, "service", "call", "/nobody", "std_srvs/Trigger", "--timeout", "2", *at)
        assert "success: true" not in said.out
        said = call(capsys, "service", "call", "/grasp", "std_srvs/Triger", *at)
        assert said.status == 1 and "did you mean 'std_srvs/Trigger'" in said.err
        said = call(capsys, "topic", "echo", "/joint_state", *at)
        assert said.status == 1 and "did you mean '/joint_states'" in said.err
    finally:
        server.send_signal(signal.SIGINT)
        out, errors = server.communicate(timeout=20)
    assert server.returncode == 130, errors
    assert f"Unity can connect to 127.0.0.1:{port}" in out and " ROS1" in out
    assert "Traceback" not in errors


def test_what_is_served_is_recorded(port, tmp_path, capsys):
    runs = tmp_path / "runs"
    options = ("--unity", "--port", port, "--mode", "fake", "--seed", 5, "--record", "--runs", runs)
    server = start("serve", "panda_pick", *options)
    try:
        wait_for_port(port, server)
        at = ("--connect", f"127.0.0.1:{port}")
        end = time.monotonic() + 60
        while "- 0.005" not in call(capsys, "topic", "echo", "/joint_states", "-n", "1", *at).out:
            call(capsys, "topic", "pub", "/gripper_command", "std_msgs/Float64", "{data: 0.01}", *at)
            assert time.monotonic() < end
    finally:
        server.send_signal(signal.SIGINT)
        _, errors = server.communicate(timeout=30)
    assert server.returncode == 130 and "Traceback" not in errors, errors
    (folder,) = runs.iterdir()
    assert f"report: {folder}/report.html" in errors.replace("\n", "")
    record = read_record(folder)
    assert (
        not record.cut and record.metadata["by"] == "those who join the cell" and record.metadata["seed"] == 5
    )
    assert record.result is not None and record.result["success"]
    assert record.result["command"] == "armcell serve panda_pick --unity --mode fake --seed 5"
    first, last = (state.sample().gripper_width["hand"] for state in (record.states[0], record.states[-1]))
    assert first > 0.05 and last == pytest.approx(0.01, abs=1e-3)


def test_sim_in_unitys_place(port, capsys):
    """Our simulator joins our own endpoint; a third program watches it there."""
    from armcell.ros import Bus
    from armcell.ros.tcp import RosTcpServer, ServerSettings

    bus = Bus()
    states = bus.subscribe("/joint_states", "sensor_msgs/JointState")
    with RosTcpServer(bus, ServerSettings(port=port, protocol="ROS2")):
        simulator = start(
            "sim", "panda_pick", "--connect", f"127.0.0.1:{port}", "--mode", "fake", "--for", "20"
        )
        try:
            state = states.get(timeout=60)
            assert state is not None and "panda_joint1" in state.name
            end = time.monotonic() + 10
            while (bus.topic_type("/planned_trajectory")) is None and time.monotonic() < end:
                time.sleep(0.01)
            assert bus.topic_type("/planned_trajectory") == "trajectory_msgs/JointTrajectory"
        finally:
            simulator.send_signal(signal.SIGINT)
            simulator.communicate(timeout=20)
        assert simulator.returncode == 130


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["serve", "panda_pick"], "give --unity"),
        (["serve", "nope", "--unity", "--port", "0"], "unknown cell 'nope'"),
        (["serve", "panda_pick", "--unity", "--port", "0", "--protocol", "ROS3"], "protocol is 'ROS3'"),
        (["serve", "panda_pick", "--unity", "--port", "0", "--mode", "nope"], "unknown mode 'nope'"),
        (["serve", "six_axis_pick", "--unity", "--port", "0", "--mode", "real"], "no campaign can show what"),
        (["serve", "panda_pick", "--unity", "--port", "0", "--plan-only", "--record"], "nothing to record"),
        (["sim", "panda_pick", "--connect", "here"], "'here' is no address"),
        (["topic", "list", "--connect", "127.0.0.1:1"], "no ROS-TCP endpoint at 127.0.0.1:1"),
        (["topic", "pub", "/a", "std_msgs/Float64", "{date: 1}"], "did you mean 'data'"),
        (["topic", "pub", "/a", "std_msgs/Floaf64", "{}"], "unknown message type"),
    ],
)
def test_mistakes_are_one_line(capsys, arguments, reason):
    said = call(capsys, *arguments)
    assert said.status == 1
    assert reason in said.err and len(said.err.splitlines()) == 1


def test_a_port_in_use_is_said_before_anything_is_loaded(capsys, monkeypatch):
    monkeypatch.delattr("armcell.cli.serve._run")
    with socket.create_server(("127.0.0.1", 0)) as other:
        said = call(capsys, "serve", "panda_pick", "--unity", "--port", other.getsockname()[1])
    assert said.status == 1 and "Address already in use" in said.err


def test_a_namespace_and_a_remapping_of_the_command_line(port, capsys):
    names = ("--ns", "arm_left", "--remap", "trajectory_status:=/words", "--remap", "nothing:=/x")
    server = start("serve", "panda_pick", "--unity", "--port", port, "--mode", "fake", *names)
    try:
        wait_for_port(port, server)
        listed = call(capsys, "topic", "list", "--connect", f"127.0.0.1:{port}").out
        for line in ("/arm_left/joint_states  ", "/words  std_msgs/String", "/arm_left/robot_description  "):
            assert line in listed
        assert "\n/joint_states" not in listed and "\n/tf  " in listed
    finally:
        server.send_signal(signal.SIGINT)
        _, errors = server.communicate(timeout=20)
    assert "the cell has no topic, service or action /nothing" in errors and "Traceback" not in errors
