"""The ROS-TCP client in Unity's place: at our server, and on the wire byte for byte."""

import json
import logging
import socket
import struct
import time

import numpy as np
import pytest
from tests.ros.tcp_helpers import text, wait_for

from armcell.core import InputError
from armcell.ros import Bus, ServiceError, cdr_codec, schema
from armcell.ros.codec import ros1_codec
from armcell.ros.tcp import ForwardedNames, RosTcpClient, RosTcpServer, ServerSettings

STATE = "sensor_msgs/JointState"
TEXT = "std_msgs/String"


@pytest.fixture(params=["ROS1", "ROS2"])
def protocol(request):
    return request.param


@pytest.fixture
def pair(protocol):
    """Two programs, joined: (simulator's bus, planner's bus, client, server)."""
    simulator, planner = Bus(), Bus()
    bridge = ForwardedNames(
        publish={"/joint_states": STATE},
        subscribe={"/planned": TEXT},
        implement={"/grip": "std_srvs/SetBool"},
        use={"/plan": "std_srvs/Trigger"},
    )
    with (
        RosTcpServer(planner, ServerSettings(port=0, protocol=protocol)) as server,
        RosTcpClient(simulator, *server.address, bridge) as client,
    ):
        assert client.wait_connected(5)
        yield simulator, planner, client, server


def test_the_handshake_decides_the_encoding(pair, protocol):
    _, _, client, server = pair
    wait_for(lambda: server.clients()[0].protocol == protocol)
    assert client.connection.codec.name == {"ROS1": "ros1", "ROS2": "cdr"}[protocol]


def test_topics_and_services_go_both_ways(pair):
    simulator, planner, _, _ = pair
    _, response = schema().service("std_srvs/SetBool")
    simulator.serve("/grip", "std_srvs/SetBool", lambda r: response(r.data, "gripped"))
    _, plan_response = schema().service("std_srvs/Trigger")
    planner.serve("/plan", "std_srvs/Trigger", lambda _: plan_response(True, "planned"))
    states = planner.subscribe("/joint_states", STATE)
    planned = simulator.subscribe("/planned", TEXT)
    up, down = simulator.advertise("/joint_states", STATE), planner.advertise("/planned", TEXT)
    wait_for(lambda: up.subscribers == 1 and down.subscribers == 1)
    up.publish(schema().new(STATE, name=["a"], position=np.array([0.5])))
    assert states.get(5).position.tolist() == [0.5]
    down.publish(text("go"))
    assert planned.get(5).data == "go"
    assert planner.wait_for_service("/grip", 5)
    assert planner.call("/grip", schema().new("std_srvs/SetBoolRequest", data=True)).message == "gripped"
    assert simulator.call("/plan", schema().new("std_srvs/TriggerRequest")).message == "planned"


def test_a_service_that_fails_here_is_answered_there(pair):
    simulator, planner, _, _ = pair
    assert planner.wait_for_service("/grip", 5)  # bridged, but nobody serves it on the simulator's bus
    assert not planner.call("/grip", schema().new("std_srvs/SetBoolRequest", data=True)).success
    with pytest.raises(ServiceError):
        simulator.call("/grip", schema().new("std_srvs/SetBoolRequest"))


@pytest.mark.slow
def test_it_connects_when_the_endpoint_comes_and_again_when_it_returns():
    simulator, planner = Bus(), Bus()
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    bridge = ForwardedNames(
        publish={"/map": TEXT}, subscribe={"/planned": TEXT}, use={"/plan": "std_srvs/Trigger"}
    )
    simulator.advertise("/map", TEXT, latch=True).publish(text("latched"))
    with RosTcpClient(simulator, "127.0.0.1", port, bridge) as client:
        for i in range(2):
            got = planner.subscribe("/map", TEXT)
            with RosTcpServer(planner, ServerSettings(port=port)):
                assert client.wait_connected(10)
                assert got.get(5).data == "latched"
                down = planner.advertise("/planned", TEXT)
                wait_for(lambda: down.subscribers == 1)  # noqa: B023
                assert simulator.wait_for_service("/plan", 5)
            wait_for(lambda: not client.wait_connected(0))
            wait_for(lambda: "/plan" not in simulator.services())
            got.close()
            assert client.connections == i + 1


def test_registrations_byte_for_byte_in_ros2_mode():
    """Names and JSON end in NUL and the NUL is counted; keep-alives fill silent seconds."""
    with socket.create_server(("127.0.0.1", 0)) as endpoint:
        bus = Bus()
        bridge = ForwardedNames(publish={"/a": TEXT}, subscribe={"/b": TEXT})
        with RosTcpClient(bus, *endpoint.getsockname(), bridge):
            peer, _ = endpoint.accept()
            with peer:
                peer.settimeout(5)
                assert peer.recv(8) == bytes(8)
                metadata = json.dumps({"protocol": "ROS2"})
                peer.sendall(frame(b"__handshake", json.dumps({"version": "v0.7.0", "metadata": metadata})))
                expected = frame(
                    b"__publish\0",
                    '{"topic":"/a","message_name":"std_msgs/String","queue_size":10,"latch":false}\0',
                ) + frame(b"__subscribe\0", '{"topic":"/b","message_name":"std_msgs/String"}\0')
                assert receive(peer, len(expected)) == expected
                publisher = bus.advertise("/a", TEXT)
                wait_for(lambda: publisher.subscribers == 1)
                publisher.publish(text("hi"))
                message = frame(b"/a\0", bytes(cdr_codec().encode(text("hi"))))
                assert receive(peer, len(message)) == message
                start = time.monotonic()
                assert receive(peer, 8) == bytes(8)
                assert 0.5 < time.monotonic() - start < 20


@pytest.mark.slow
def test_an_endpoint_older_than_the_handshake(caplog):
    caplog.set_level(logging.WARNING, logger="armcell.ros.tcp.client")  # `armcell topic` silences it
    with socket.create_server(("127.0.0.1", 0)) as endpoint:
        bus = Bus()
        got = bus.subscribe("/b", TEXT)
        with RosTcpClient(bus, *endpoint.getsockname(), ForwardedNames(subscribe={"/b": TEXT})) as client:
            peer, _ = endpoint.accept()
            with peer:
                peer.settimeout(5)
                peer.sendall(bytes(8))  # what endpoint 0.6 greets with
                assert client.wait_connected(5)
                peer.sendall(frame(b"/b", bytes(ros1_codec().encode(text("old")))))
                assert got.get(5).data == "old"
    assert "sent no handshake" in caplog.text


def test_an_endpoints_errors_are_logged_not_answered(caplog):
    with (
        socket.create_server(("127.0.0.1", 0)) as endpoint,
        RosTcpClient(Bus(), *endpoint.getsockname(), ForwardedNames()) as client,
    ):
        peer, _ = endpoint.accept()
        with peer:
            peer.settimeout(2.5)
            handshake = json.dumps({"version": "v0.7.0", "metadata": "{}"})
            peer.sendall(frame(b"__handshake", handshake))
            assert client.wait_connected(5)
            peer.sendall(frame(b"__error", '{"text":"unknown class"}') + frame(b"__odd", "{}"))
            time.sleep(0.2)
            assert receive(peer, 16) == bytes(16)  # keep-alives, nothing else
    assert "says: unknown class" in caplog.text and "unknown command '__odd'" in caplog.text


def test_a_bridge_goes_one_way_per_topic():
    with pytest.raises(InputError, match="/a is bridged both ways"):
        ForwardedNames(publish={"/a": TEXT}, subscribe={"/a": TEXT})


def frame(name, body):
    body = body.encode() if isinstance(body, str) else body
    return struct.pack("<I", len(name)) + name + struct.pack("<I", len(body)) + body


def receive(peer, count):
    data = b""
    while len(data) < count:
        piece = peer.recv(count - len(data))
        assert piece, data
        data += piece
    return data
