"""Bad input on the ROS-TCP wire: answered as the protocol allows, logged once, nobody else disturbed."""

import json
import logging
import struct

import pytest
from tests.ros.tcp_helpers import frame
from tests.ros.unity_like import UnityLike

from armcell.ros import schema
from armcell.ros.codec import ros1_codec
from armcell.ros.tcp.framing import MAX_BODY, FrameError, FrameReader, command

TRAJECTORY = "trajectory_msgs/JointTrajectory"


@pytest.fixture
def bystander(bus, server):
    """Another client, which must go on as if nothing happened."""
    with UnityLike(server.address) as unity:
        unity.register("__publish", "/chat", "std_msgs/String")
        got = bus.subscribe("/chat", "std_msgs/String")
        unity.read_until("__handshake")
        yield unity
        unity.message("/chat", ros1_codec().encode(schema().new("std_msgs/String", data="fine")))
        assert got.get(5).data == "fine"
        assert unity.buffer == b""
        unity.command("__ping", request_time=1)
        assert unity.read()[0] == "__ping_response"  # no word of the other's errors


def sub(**params):
    return json.dumps({"topic": "/a", "message_name": "std_msgs/String"} | params).encode()


STAYS = {
    "unknown command": (frame(b"__dance", b"{}"), "unknown command '__dance'; known: __ping"),
    "old unsubscribe": (frame(b"__unsubscribe", sub()), "unknown command '__unsubscribe'"),
    "no JSON": (frame(b"__subscribe", b"{topic"), "__subscribe: not JSON"),
    "invalid UTF-8 in JSON": (frame(b"__subscribe", b'{"topic":"\xff"}'), "__subscribe: not JSON"),
    "a list": (frame(b"__subscribe", b"[1]"), "a JSON object is needed, not a list"),
    "nested too deep": (frame(b"__subscribe", b"[" * 100_000), "__subscribe: not JSON"),
    "huge JSON": (frame(b"__subscribe", b" " * (2 << 20)), "bytes of JSON, at most"),
    "missing key": (frame(b"__subscribe", b'{"topic":"/a"}'), "needs 'message_name' as str"),
    "wrong kind": (frame(b"__subscribe", sub(topic=3)), "needs 'topic' as str, has '3'"),
    "empty topic": (frame(b"__publish", sub(topic="")), "'' is no topic or service name"),
    "odd topic": (frame(b"__publish", sub(topic="a b\0")), "is no topic or service name"),
    "unknown type": (frame(b"__subscribe", sub(message_name="std_msgs/Strin")), "did you mean 'std_msgs/S"),
    "a module": (frame(b"__subscribe", sub(message_name="os/system")), "unknown message type 'os/system'"),
    "a path": (frame(b"__publish", sub(message_name="../../etc/passwd")), "unknown message type"),
    "a message as service": (frame(b"__ros_service", sub()), "unknown service type 'std_msgs/String'"),
    "not registered": (frame(b"/a", b"\0\0\0\0"), "'/a' is not registered for publishing"),
    "no number": (frame(b"__request", b'{"srv_id":"1"}'), "needs 'srv_id' as int"),
    "truth is no number": (frame(b"__request", b'{"srv_id":true}'), "needs 'srv_id' as int"),
    "command in place of a body": (
        frame(b"__request", b'{"srv_id":1}') + frame(b"__topic_list", b"{}"),
        "where the body of service call 1 was due",
    ),
    "cut message": (frame(b"__publish", sub()) + frame(b"/a", b"\x09\0\0\0abc"), "7 bytes are no std_msgs"),
    "long message": (frame(b"__publish", sub()) + frame(b"/a", b"\1\0\0\0abc"), "7 bytes are no std_msgs"),
    "invalid UTF-8": (frame(b"__publish", sub()) + frame(b"/a", b"\1\0\0\0\xff"), "5 bytes are no std_msgs"),
    "4 GiB of text": (
        frame(b"__publish", sub()) + frame(b"/a", b"\xff\xff\xff\xffabc"), "7 bytes are no std_msgs"
    ),
    "two types": (
        frame(b"__publish", sub()) + frame(b"__subscribe", sub(message_name="std_msgs/Int32")),
        "topic /a carries std_msgs/String, not std_msgs/Int32",
    ),
}  # fmt: skip

ENDS = {
    "random bytes": (bytes(range(40, 120)), "not ROS-TCP?"),
    "HTTP": (b"GET / HTTP/1.1\r\nHost: x\r\n\r\n", "not ROS-TCP?"),
    "name of 4 GiB": (b"\xff\xff\xff\xff", "a name of 4294967295 bytes"),
    "body of 4 GiB": (b"\x02\0\0\0/a\xff\xff\xff\xff", "a message of 4294967295 bytes"),
    "body beyond the cap": (b"\x02\0\0\0/a" + struct.pack("<I", MAX_BODY + 1), "a message of"),
    "name of no text": (frame(b"\xff\xfe", b""), "a name that is no UTF-8"),
}


@pytest.mark.slow
@pytest.mark.parametrize("what", STAYS)
def test_a_mistake_is_told_and_the_connection_goes_on(bus, server, bystander, what, caplog):
    data, expected = STAYS[what]
    with UnityLike(server.address) as unity, caplog.at_level(logging.WARNING):
        for _ in range(3):
            unity.socket.sendall(data)
        assert expected in unity.read_until("__error")["text"]
        unity.command("__ping", request_time=1)
        while (answer := unity.read())[0] != "__ping_response":
            assert answer[0] not in ("__error", "/a"), answer  # told once, though done three times
        unity.register("__publish", "/b", "std_msgs/String")
        got = bus.subscribe("/b", "std_msgs/String")
        unity.message("/b", ros1_codec().encode(schema().new("std_msgs/String", data="on we go")))
        assert got.get(5).data == "on we go"
        address = f"127.0.0.1:{unity.socket.getsockname()[1]}"
    assert len([r for r in caplog.records if address in r.getMessage()]) == 1


@pytest.mark.parametrize("what", ENDS)
def test_bytes_that_make_no_frames_end_the_connection_with_a_word(server, bystander, what, caplog):
    data, expected = ENDS[what]
    with UnityLike(server.address) as unity, caplog.at_level(logging.WARNING):
        unity.socket.sendall(data)
        text = unity.read_until("__error")["text"]
        assert expected in text and text.startswith("closed: ")
        assert unity.read() is None
    assert len([r for r in caplog.records if "closed: " in r.getMessage()]) == 1


def test_extra_keys_and_nul_are_taken(bus, server):
    with UnityLike(server.address) as unity:
        unity.register("__publish", "/a", "std_msgs/String", queue_size=10, latch=False, new_in_0_8=[1, {}])
        unity.socket.sendall(frame(b"__subscribe\0\0", sub() + b"\0\0"))
        unity.command("__ping", request_time=1)
        unity.read_until("__ping_response")
        assert bus.topics()[0].subscribers == 1


def test_numbers_that_are_none_arrive_as_they_are(bus, server):
    """NaN is for the receiver to judge: the wire carries every float."""
    point = schema().new("trajectory_msgs/JointTrajectoryPoint", positions=[float("nan"), float("inf")])
    got = bus.subscribe("/planned", TRAJECTORY)
    with UnityLike(server.address) as unity:
        unity.register("__publish", "/planned", TRAJECTORY)
        unity.message("/planned", ros1_codec().encode(schema().new(TRAJECTORY, points=[point])))
        assert str(got.get(5).points[0].positions.tolist()) == "[nan, inf]"


def test_a_message_that_cannot_be_encoded_is_told_and_the_publisher_goes_on(bus, server):
    with UnityLike(server.address) as unity:
        unity.register("__subscribe", "/a", "std_msgs/String")
        unity.read_until("__handshake")
        publisher = bus.advertise("/a", "std_msgs/String")
        while not publisher.subscribers:
            pass
        publisher.publish(schema().new("std_msgs/String", data=3))
        publisher.publish(schema().new("std_msgs/String", data="x"))
        assert "data is 3" in unity.read_until("__error")["text"]
        assert unity.read_until("/a") == b"\1\0\0\0x"


def test_more_kinds_of_mistakes_than_anybody_reads(server, caplog):
    with UnityLike(server.address) as unity, caplog.at_level(logging.WARNING):
        for i in range(1000):
            unity.command(f"__dance{i}")
        unity.command("__ping", request_time=1)
        errors = 0
        while (answer := unity.read())[0] != "__ping_response":
            errors += answer[0] == "__error"
        assert errors == 101
        assert server.clients()[0].errors == 1000
    assert len(caplog.records) == 101


def test_registrations_are_bounded(server):
    with UnityLike(server.address) as unity:
        for i in range(4097):
            unity.socket.sendall(command("__publish", {"topic": f"/t{i}", "message_name": "std_msgs/String"}))
        assert "more than 4096 registrations" in unity.read_until("__error", timeout=20)["text"]


def test_a_reader_holds_no_more_than_it_received():
    reader = FrameReader()
    assert reader.feed(b"\x02\0\0\0/a" + struct.pack("<I", MAX_BODY) + b"x") == []
    assert len(reader._buffer) == 11
    with pytest.raises(FrameError):
        FrameReader(max_body=10).feed(frame(b"/a", b"x" * 11))
