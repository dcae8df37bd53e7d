"""The ROS-TCP server with many, slow and vanishing clients; its settings."""

import socket
import struct
import threading
import time

import numpy as np
import pytest
from tests.ros.tcp_helpers import (
    ANY_PORT,
    frame,
    frames_until_silence,
    joined,
    receive_until,
    text,
    wait_for,
)
from tests.ros.unity_like import UnityLike

from armcell.core import InputError
from armcell.ros import Bus, Schema, schema
from armcell.ros.codec import ros1_codec
from armcell.ros.tcp import RosTcpServer, ServerSettings


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
            assert ros1_codec().decode("std_msgs/String", reader.read_until("/chat")).data == str(i)
        assert longest < 0.5
        status = {c.address.split(":")[1]: c for c in server.clients()}
        behind = status[str(stalled.socket.getsockname()[1])]
        assert behind.dropped > 40
        assert behind.waiting_bytes <= 4 << 20
        images_read = [name for name, _ in frames_until_silence(stalled)].count("/image")
        assert images_read == 60 - behind.dropped


def test_a_client_that_asks_without_reading_is_given_up(bus, monkeypatch):
    from armcell.ros.tcp import server as module
    from armcell.ros.tcp.connection import OutboxLimits

    monkeypatch.setattr(
        module, "OutboxLimits", lambda messages: OutboxLimits(messages, control_bytes=1 << 20)
    )
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
            data = ros1_codec().decode("std_msgs/UInt8MultiArray", body).data
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
