"""The ROS-TCP server, seen by clients that behave as Unity's connector."""

import json
import socket
import struct
import threading
import time

import numpy as np
import pytest
from tests.ros.unity_like import UnityLike

from armcell.core import InputError
from armcell.ros import Bus, Schema, ServiceError, cdr, schema
from armcell.ros.codec import ros1
from armcell.ros.tcp import RosTcpServer, ServerSettings

ANY_PORT = ServerSettings(port=0)
MODES = [False, True]
IDS = ["ROS1", "ROS2"]


@pytest.fixture
def bus():
    return Bus()


@pytest.fixture
def server(bus):
    with RosTcpServer(bus, ANY_PORT) as server:
        yield server


def codec(ros2):
    return cdr() if ros2 else ros1()


def text(value):
    return schema().new("std_msgs/String", data=value)


def wait_for(condition, timeout=5.0):
    end = time.monotonic() + timeout
    while not condition() and time.monotonic() < end:
        time.sleep(0.002)
    assert condition()


def joined(bus, topic):
    return next((t for t in bus.topics() if t.name == topic), None)


# --- the wire, byte for byte ---
def test_the_first_frame_is_the_handshake_byte_for_byte(server):
    with socket.create_connection(server.address) as raw:
        raw.sendall(bytes(8) + frame(b"__topic_list", b"{}"))
        body = b'{"version":"v0.7.0","metadata":"{\\"protocol\\": \\"ROS1\\"}"}'
        golden = b"\x0b\0\0\0__handshake" + struct.pack("<I", len(body)) + body
        assert receive(raw, len(golden)) == golden
        metadata = json.loads(body)["metadata"]
        assert json.loads(metadata) == {"protocol": "ROS1"}  # a JSON text inside the JSON


def test_a_message_to_unity_byte_for_byte(bus, server):
    with socket.create_connection(server.address) as raw:
        raw.sendall(frame(b"__subscribe", b'{"topic":"chat","message_name":"std_msgs/String"}'))
        wait_for(lambda: joined(bus, "/chat"))
        bus.advertise("/chat", "std_msgs/String").publish(text("hi"))
        data = receive_until(raw, b"hi")
        assert data.endswith(
            b"\x04\0\0\0chat" + b"\x06\0\0\0" + b"\x02\0\0\0hi"
        )  # the name as Unity spelt it


def test_a_message_to_unity_in_ros2_mode_byte_for_byte(bus, server):
    with socket.create_connection(server.address) as raw:
        raw.sendall(frame(b"__subscribe\0", b'{"topic":"/chat","message_name":"std_msgs/String"}\0'))
        wait_for(lambda: joined(bus, "/chat"))
        bus.advertise("/chat", "std_msgs/String").publish(text("hi"))
        data = receive_until(raw, b"hi\0")
        assert data.endswith(b"\x05\0\0\0/chat" + b"\x0b\0\0\0" + b"\0\1\0\0" + b"\x03\0\0\0hi\0")
        assert b'\\"ROS2\\"' in data


def frame(name, body):
    return struct.pack("<I", len(name)) + name + struct.pack("<I", len(body)) + body


def receive(raw, count):
    data = b""
    raw.settimeout(5)
    while len(data) < count:
        data += raw.recv(count - len(data))
    return data


def receive_until(raw, end):
    data = b""
    raw.settimeout(5)
    while not data.endswith(end):
        data += raw.recv(4096)
    return data


def test_three_byte_pieces_are_put_together(bus, server):
    got = bus.subscribe("/chat", "std_msgs/String")
    stream = frame(b"__publish", b'{"topic":"/chat","message_name":"std_msgs/String"}')
    stream += bytes(8) + frame(b"/chat", b"\x05\0\0\0hello") * 3
    with socket.create_connection(server.address) as raw:
        raw.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for i in range(0, len(stream), 3):
            raw.sendall(stream[i : i + 3])
        assert [got.get(5).data for _ in range(3)] == ["hello"] * 3


# --- topics ---
@pytest.mark.parametrize("ros2", MODES, ids=IDS)
def test_topics_go_both_ways(bus, server, ros2):
    state = schema().new("sensor_msgs/JointState", name=["a"], position=[0.5])
    got = bus.subscribe("/joint_states", "sensor_msgs/JointState")
    publisher = bus.advertise("/planned_trajectory", "trajectory_msgs/JointTrajectory")
    with UnityLike(server.address, ros2) as unity:
        unity.register("__publish", "/joint_states", "sensor_msgs/JointState", queue_size=10, latch=False)
        unity.register("__subscribe", "/planned_trajectory", "trajectory_msgs/JointTrajectory")
        unity.message("/joint_states", codec(ros2).encode(state))
        assert got.get(5).position.tolist() == [0.5]
        wait_for(lambda: publisher.subscribers == 1)
        publisher.publish(schema().new("trajectory_msgs/JointTrajectory", joint_names=["a", "b"]))
        body = unity.read_until("/planned_trajectory")
        back = codec(ros2).decode("trajectory_msgs/JointTrajectory", body)
        assert back.joint_names == ["a", "b"]


@pytest.mark.parametrize("ros2", MODES, ids=IDS)
def test_registering_twice_is_registering_once_and_keeps_the_latched_message(bus, server, ros2):
    """The connector registers on use and again on connecting."""
    bus.advertise("/map", "std_msgs/String", latch=True).publish(text("latched"))
    with UnityLike(server.address, ros2) as unity:
        for _ in range(2):
            unity.register("__subscribe", "/map", "std_msgs/String")
            unity.register("__publish", "/up", "std_msgs/String", latch=True)
        unity.message("/up", codec(ros2).encode(text("kept")))
        for _ in range(2):
            unity.register("__publish", "/up", "std_msgs/String", latch=True)
        unity.command("__topic_list")
        frames = frames_until_silence(unity)
        assert [name for name, _ in frames].count("/map") == 1
        assert bus.subscribe("/up", "std_msgs/String").get(5).data == "kept"
        assert (joined(bus, "/map").subscribers, joined(bus, "/up").publishers) == (1, 1)
        topics = dict(frames)["__topic_list"]
        assert dict(zip(topics["topics"], topics["types"]))["/up"] == "std_msgs/String"


def frames_until_silence(unity, silence=0.3):
    frames = []
    while True:
        try:
            frames.append(unity.read(timeout=silence))
        except TimeoutError:
            return frames


def test_removing_registrations(bus, server):
    with UnityLike(server.address) as unity:
        unity.register("__subscribe", "/a", "std_msgs/String")
        unity.register("__publish", "/b", "std_msgs/String")
        unity.register("__unity_service", "/c", "std_srvs/Trigger")
        wait_for(lambda: joined(bus, "/a") and joined(bus, "/b") and bus.services())
        unity.command("__remove_subscriber", topic="/a")
        unity.command("__remove_publisher", topic="/b")
        unity.command("__remove_unity_service", topic="/c")
        unity.command("__remove_ros_service", topic="/none")
        wait_for(lambda: not bus.topics() and not bus.services())


def test_a_client_that_goes_takes_its_registrations_with_it(bus, server):
    with UnityLike(server.address) as other:
        other.register("__subscribe", "/a", "std_msgs/String")
        unity = UnityLike(server.address)
        unity.register("__subscribe", "/a", "std_msgs/String")
        unity.register("__publish", "/b", "std_msgs/String", latch=True)
        unity.register("__unity_service", "/c", "std_srvs/Trigger")
        wait_for(lambda: joined(bus, "/a") and joined(bus, "/a").subscribers == 2 and bus.services())
        unity.close()
        wait_for(lambda: not bus.services() and [t.name for t in bus.topics()] == ["/a"])
        assert len(server.clients()) == 1
        bus.advertise("/a", "std_msgs/String").publish(text("still here"))
        assert ros1().decode("std_msgs/String", other.read_until("/a")).data == "still here"


def test_two_clients_publish_and_read_one_topic(bus, server):
    with UnityLike(server.address) as one, UnityLike(server.address, ros2=True) as two:
        for unity in (one, two):
            unity.register("__publish", "/chat", "std_msgs/String")
            unity.register("__subscribe", "/chat", "std_msgs/String")
        wait_for(lambda: joined(bus, "/chat") and joined(bus, "/chat").subscribers == 2)
        one.message("/chat", ros1().encode(text("from one")))
        assert ros1().decode("std_msgs/String", one.read_until("/chat")).data == "from one"
        assert cdr().decode("std_msgs/String", two.read_until("/chat")).data == "from one"
        two.message("/chat", cdr().encode(text("from two")))
        assert ros1().decode("std_msgs/String", one.read_until("/chat")).data == "from two"


def test_a_client_that_says_nothing_is_greeted_all_the_same(server):
    with UnityLike(server.address) as unity:
        assert unity.read(timeout=5)[0] == "__handshake"


def test_a_wrong_guess_is_put_right(bus):
    with (
        RosTcpServer(bus, ServerSettings(port=0, guess_after=0.0)) as server,
        UnityLike(server.address, ros2=True) as unity,
    ):
        assert "ROS1" in unity.read()[1]["metadata"]
        unity.register("__publish", "/chat", "std_msgs/String")
        assert "ROS2" in unity.read()[1]["metadata"]
        got = bus.subscribe("/chat", "std_msgs/String")
        unity.message("/chat", cdr().encode(text("hi")))
        assert got.get(5).data == "hi"


def test_a_fixed_protocol_tells_unity_what_to_change(bus):
    with (
        RosTcpServer(bus, ServerSettings(port=0, protocol="ROS1")) as server,
        UnityLike(server.address, ros2=True) as unity,
    ):
        assert "ROS1" in unity.read()[1]["metadata"]
        unity.register("__subscribe", "/tf", "tf2_msgs/TFMessage")
        assert "Robotics > ROS Settings" in unity.read_until("__error")["text"]


def test_ping(server):
    with UnityLike(server.address) as unity:
        unity.command("__ping", request_time=12.5)
        assert unity.read_until("__ping_response") == {"request_time": 12.5}


# --- services ---
@pytest.mark.parametrize("ros2", MODES, ids=IDS)
def test_unity_calls_a_service_of_the_bus(bus, server, ros2):
    request, response = schema().service("std_srvs/SetBool")
    bus.serve("/switch", "std_srvs/SetBool", lambda r: response(r.data, "done"))
    with UnityLike(server.address, ros2) as unity:
        unity.register("__ros_service", "/switch", "std_srvs/SetBool")
        numbers = [unity.call("/switch", codec(ros2).encode(request(on))) for on in (True, False)]
        answers = {}
        for _ in range(2):
            number = unity.read_until("__response")["srv_id"]
            name, body = unity.read()  # the very next frame
            assert name == "/switch"
            answers[number] = codec(ros2).decode("std_srvs/SetBoolResponse", body).success
        assert answers == dict(zip(numbers, (True, False)))


def test_a_slow_service_holds_up_neither_topics_nor_other_services(bus, server):
    _, response = schema().service("std_srvs/Trigger")
    go = threading.Event()

    def slow(_):
        go.wait(5)
        return response(True, "slow")

    bus.serve("/slow", "std_srvs/Trigger", slow)
    bus.serve("/quick", "std_srvs/Trigger", lambda _: response(True, "quick"))
    with UnityLike(server.address) as unity:
        slow_number = unity.call("/slow", b"")
        quick_number = unity.call("/quick", b"")
        assert unity.read_until("__response")["srv_id"] == quick_number
        go.set()
        assert unity.read_until("__response")["srv_id"] == slow_number


@pytest.mark.parametrize("how", ["fails", "unknown", "bad request", "wrong type"])
def test_a_failed_service_is_answered_all_the_same(bus, server, how):
    _, response = schema().service("std_srvs/SetBool")

    def fail(_):
        raise ZeroDivisionError("by zero")

    bus.serve("/switch", "std_srvs/SetBool", fail if how == "fails" else lambda r: response(True))
    with UnityLike(server.address) as unity:
        if how != "unknown":
            kind = "std_srvs/Trigger" if how == "wrong type" else "std_srvs/SetBool"
            unity.register("__ros_service", "/switch", kind)
        name = "/nobody" if how == "unknown" else "/switch"
        number = unity.call(name, b"\1\2\3" if how == "bad request" else b"\1")
        error = unity.read_until("__error")["text"]
        expected = {
            "fails": "ZeroDivisionError: by zero", "unknown": "unknown service",
            "bad request": "3 bytes are no",
            "wrong type": "is of type std_srvs/SetBool, not std_srvs/Trigger",
        }[how]  # fmt: skip
        assert expected in error
        assert unity.read_until("__response")["srv_id"] == number
        name_back, body = unity.read()
        assert name_back == name
        if how in ("fails", "bad request"):
            assert not ros1().decode("std_srvs/SetBoolResponse", body).success


def serve_like_unity(unity, ros2, count, delay=0.0):
    """Answers service requests in a thread, as the connector's main loop does."""

    def run():
        for _ in range(count):
            number = unity.read_until("__request")["srv_id"]
            name, body = unity.read()
            data = codec(ros2).decode("std_srvs/SetBoolRequest", body).data
            time.sleep(delay)
            unity.command("__response", srv_id=number)
            answer = schema().new("std_srvs/SetBoolResponse", success=data, message=name)
            unity.message(name, codec(ros2).encode(answer))

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    return thread


@pytest.mark.parametrize("ros2", MODES, ids=IDS)
def test_the_bus_calls_a_service_of_unity(bus, server, ros2):
    request, _ = schema().service("std_srvs/SetBool")
    with UnityLike(server.address, ros2) as unity:
        for _ in range(2):
            unity.register("__unity_service", "/grip", "std_srvs/SetBool")
        assert bus.wait_for_service("/grip", 5)
        serve_like_unity(unity, ros2, 2)
        assert bus.call("/grip", request(True)).success
        assert bus.call("/grip", request(False)).message == "/grip"


def test_a_service_of_unity_that_went_or_hangs_fails_in_time(bus):
    request, _ = schema().service("std_srvs/SetBool")
    with RosTcpServer(bus, ServerSettings(port=0, service_timeout=0.2)) as server:
        unity = UnityLike(server.address)
        unity.register("__unity_service", "/grip", "std_srvs/SetBool")
        assert bus.wait_for_service("/grip", 5)
        with pytest.raises(ServiceError, match=r"gave no answer in 0\.2 s"):
            bus.call("/grip", request(True))
    with RosTcpServer(bus, ServerSettings(port=0, service_timeout=30)) as server:
        unity = UnityLike(server.address)
        unity.register("__unity_service", "/grip", "std_srvs/SetBool")
        assert bus.wait_for_service("/grip", 5)
        threading.Timer(0.1, unity.close).start()
        start = time.monotonic()
        with pytest.raises(ServiceError, match="went away"):
            bus.call("/grip", request(True))
        assert time.monotonic() - start < 5


def test_a_late_answer_and_one_to_nobody_are_told_and_change_nothing(bus, server):
    with UnityLike(server.address) as unity:
        unity.command("__response", srv_id=7)
        unity.message("/grip", b"\0")
        assert "nobody waits for" in unity.read_until("__error")["text"]
        unity.command("__ping", request_time=1)
        unity.read_until("__ping_response")


def test_the_newer_of_two_servers_of_a_service_wins(bus, server):
    """Unity started again while its old connection still hangs."""
    request, _ = schema().service("std_srvs/SetBool")
    with UnityLike(server.address) as old, UnityLike(server.address) as new:
        old.register("__unity_service", "/grip", "std_srvs/SetBool")
        assert bus.wait_for_service("/grip", 5)
        new.register("__unity_service", "grip", "std_srvs/SetBool")
        assert "now served by" in old.read_until("__warn")["text"]
        wait_for(lambda: "/grip" in bus.services())
        serve_like_unity(new, False, 1)
        assert bus.call("/grip", request(True)).success


def test_a_service_of_this_program_is_not_taken_over(bus, server):
    _, response = schema().service("std_srvs/SetBool")
    bus.serve("/grip", "std_srvs/SetBool", lambda r: response())
    with UnityLike(server.address) as unity:
        unity.register("__unity_service", "/grip", "std_srvs/SetBool")
        assert "already served" in unity.read_until("__error")["text"]


# --- many, slow and vanishing clients ---
def test_a_stalled_client_delays_nobody_and_its_queue_stays_bounded(bus):
    image = schema().new("sensor_msgs/Image", data=np.zeros(1 << 20, np.uint8))
    with (
        RosTcpServer(bus, ServerSettings(port=0, queue=3)) as server,
        UnityLike(server.address, poll=0) as stalled,
        UnityLike(server.address, poll=0) as reader,
    ):
        for unity in (stalled, reader):
            unity.register("__subscribe", "/image", "sensor_msgs/Image")
        reader.register("__subscribe", "/chat", "std_msgs/String")
        images = bus.advertise("/image", "sensor_msgs/Image")
        chat = bus.advertise("/chat", "std_msgs/String")
        wait_for(lambda: images.subscribers == 2 and chat.subscribers == 1)
        longest = 0.0
        for i in range(60):
            start = time.monotonic()
            images.publish(image)
            chat.publish(text(str(i)))
            longest = max(longest, time.monotonic() - start)
            assert ros1().decode("std_msgs/String", reader.read_until("/chat")).data == str(i)
        assert longest < 0.5
        status = {c.address.split(":")[1]: c for c in server.clients()}
        behind = status[str(stalled.socket.getsockname()[1])]
        assert behind.dropped > 40
        assert behind.waiting_bytes <= 4 << 20
        images_read = [name for name, _ in frames_until_silence(stalled)].count("/image")
        assert images_read == 60 - behind.dropped


def test_a_client_that_asks_without_reading_is_given_up(bus, monkeypatch):
    from armcell.ros.tcp import server as module
    from armcell.ros.tcp.outbox import Caps

    monkeypatch.setattr(module, "Caps", lambda messages: Caps(messages, control_bytes=1 << 20))
    for i in range(50):
        bus.advertise(f"/a_topic_with_a_long_name_{i}", "std_msgs/String")
    with RosTcpServer(bus, ANY_PORT) as server:
        unity = UnityLike(server.address)
        ask = frame(b"__topic_list", b"{}") * 100
        unity.socket.settimeout(0.05)
        end = time.monotonic() + 20
        while server.clients() and time.monotonic() < end:
            try:
                unity.socket.send(ask)
            except TimeoutError:
                continue
            except OSError:
                break
        wait_for(lambda: not server.clients())


@pytest.mark.slow
def test_a_thousand_connects_and_disconnects_leave_nothing_behind(bus, server):
    def open_files():
        import os

        return len(os.listdir("/proc/self/fd"))

    before, threads = open_files(), threading.active_count()
    for i in range(1000):
        unity = UnityLike(server.address, ros2=bool(i % 2))
        if i % 3:
            unity.register("__subscribe", "/a", "std_msgs/String")
            unity.register("__publish", "/b", "std_msgs/String")
        if i % 5 == 0:
            unity.socket.sendall(b"\x10\0\0\0half")
        unity.close()
    wait_for(lambda: server.total_clients == 1000 and not server.clients(), timeout=20)
    wait_for(lambda: not bus.topics())
    wait_for(lambda: open_files() <= before + 2 and threading.active_count() <= threads + 2, timeout=20)


def test_too_many_clients_are_told(bus):
    with RosTcpServer(bus, ServerSettings(port=0, max_clients=2)) as server:
        with UnityLike(server.address), UnityLike(server.address):
            wait_for(lambda: len(server.clients()) == 2)
            with socket.create_connection(server.address) as third:
                data = receive_until(third, b"}")
                assert b"2 clients are connected, that is the most" in data
        wait_for(lambda: not server.clients())
        with UnityLike(server.address) as unity:
            assert unity.read()[0] == "__handshake"


def test_a_port_in_use_is_one_clear_error(bus, server):
    with pytest.raises(InputError, match=r"cannot listen on 127\.0\.0\.1:\d+ \(Address already in use\)"):
        RosTcpServer(bus, ServerSettings(port=server.address[1])).start()


def test_it_listens_on_this_machine_only_unless_told(server):
    assert server.address[0] == "127.0.0.1"


def test_settings_are_checked():
    for wrong in ({"protocol": "ROS3"}, {"port": 70000}, {"queue": 0}):
        with pytest.raises(InputError):
            ServerSettings(**wrong)


def test_a_bus_may_outlive_its_server(bus):
    with RosTcpServer(bus, ANY_PORT) as server:
        unity = UnityLike(server.address)
        unity.register("__subscribe", "/a", "std_msgs/String")
        wait_for(lambda: joined(bus, "/a"))
    assert bus.topics() == []
    while unity.read() is not None:
        pass


def test_frames_stay_whole_and_in_order_however_slowly_they_are_read(bus, server):
    """Sent at once, sent in part and queued, from several threads, into a socket that is mostly full."""
    count, size, topics = 150, 40_000, [f"/t{i}" for i in range(4)]
    with UnityLike(server.address, poll=0) as unity:
        for topic in topics:
            unity.register("__subscribe", topic, "std_msgs/UInt8MultiArray")
        publishers = [bus.advertise(topic, "std_msgs/UInt8MultiArray") for topic in topics]
        wait_for(lambda: all(p.subscribers for p in publishers))

        def publish(publisher):
            for i in range(count):
                message = schema().new("std_msgs/UInt8MultiArray", data=np.full(size, i, np.uint8))
                publisher.publish(message)
                time.sleep(0.001)

        threads = [threading.Thread(target=publish, args=(p,)) for p in publishers]
        for thread in threads:
            thread.start()
        got = {topic: [] for topic in topics}
        while any(thread.is_alive() for thread in threads):
            read_states(unity, got, 0.05)
            time.sleep(0.01)
        read_states(unity, got, 0.5)
    for numbers in got.values():
        assert numbers == sorted(set(numbers)) and numbers[-1] == count - 1
    dropped = 4 * count - sum(len(numbers) for numbers in got.values())
    assert dropped < 4 * count // 2


def read_states(unity, got, silence):
    while True:
        try:
            name, body = unity.read(timeout=silence)
        except TimeoutError:
            return
        if name in got:
            data = ros1().decode("std_msgs/UInt8MultiArray", body).data
            assert len(data) == 40_000 and (data == data[0]).all()
            got[name].append(int(data[0]))


def test_own_message_types_travel_too(tmp_path):
    folder = tmp_path / "my_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Weld.msg").write_text("float64 force\ngeometry_msgs/Point at\n")
    bus = Bus(Schema(tmp_path))
    got = bus.subscribe("/weld", "my_msgs/Weld")
    with RosTcpServer(bus, ANY_PORT) as server, UnityLike(server.address) as unity:
        unity.register("__publish", "/weld", "my_msgs/Weld")
        unity.message("/weld", struct.pack("<4d", 5.0, 1.0, 2.0, 3.0))
        weld = got.get(5)
        assert (weld.force, weld.at.z) == (5.0, 3.0)
