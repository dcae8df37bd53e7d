"""What nobody should send: each is answered as the protocol allows, and everybody else goes on."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time
from dataclasses import replace
from xmlrpc.client import ServerProxy

import numpy as np
import pytest
from tests.ros.ros1.conftest import eventually, free_port

from armcell.ros import Bus, ServiceError, schema
from armcell.ros.codec import WireError, ros1_codec
from armcell.ros.ros1 import Ros1Graph, Ros1Settings
from armcell.ros.ros1.sockets import decode_header, encode_header, receive

S = schema()
STRING = "std_msgs/String"


@pytest.fixture
def node(joined):
    """A graph with a topic and a service; and, on another bus, somebody who must go on hearing."""
    graph = joined("a")
    graph.bus.serve("/ask", "std_srvs/Trigger", lambda _: S.new("std_srvs/TriggerResponse", True, "yes"))
    graph.out = graph.bus.advertise("/out", STRING)
    graph.inbox = joined("b").bus.subscribe("/out", STRING)
    eventually(lambda: graph.out.subscribers)
    yield graph
    graph.out.publish(S.new(STRING, "still here"))
    assert graph.inbox.get(5).data == "still here"


def connect(node) -> socket.socket:
    return socket.create_connection(node.node._tcpros.address, timeout=5)


def subscriber(**changes) -> dict[str, str]:
    fields = {"callerid": "/x", "topic": "/out", "type": STRING, "md5sum": S.md5(STRING)}
    return {k: v for k, v in {**fields, **changes}.items() if v}


def answer(node, fields) -> dict[str, str]:
    with connect(node) as sock:
        sock.sendall(encode_header(fields))
        return receive(sock)


@pytest.mark.cases("fields0-*", "fields3-*", "fields6-*", "fields7-*")
@pytest.mark.parametrize(
    ("fields", "error"),
    [
        (subscriber(md5sum="0" * 32), "wants topic [/out] to have datatype/md5sum"),
        (subscriber(type="std_msgs/Int32", md5sum=S.md5("std_msgs/Int32")), "topic types do not match"),
        (subscriber(topic="/none"), "is not a publisher of [/none]"),
        (subscriber(callerid=""), "Missing required 'callerid' field"),
        (subscriber(md5sum=""), "Missing required 'md5sum' field"),
        ({"callerid": "/x"}, "no topic or service name detected"),
        ({"callerid": "/x", "service": "/none", "md5sum": "*"}, "is not a provider of"),
        ({"callerid": "/x", "service": "/ask", "md5sum": "1"}, "md5sums do not match: [1] vs. [937c9679"),
        ({"service": "/ask", "md5sum": "*"}, "Missing required 'callerid' field"),
    ],
)
def test_wrong_headers_are_refused_in_the_real_ones_words(node, fields, error):
    assert error in answer(node, fields)["error"]
    assert node.node.mistakes == 1


def test_anything_is_taken_where_it_is_asked_for(node):
    header = answer(node, subscriber(type="*", md5sum="*"))
    assert header["type"] == STRING and header["md5sum"] == S.md5(STRING) and header["latching"] == "0"
    assert answer(node, {"callerid": "/x", "service": "/ask", "md5sum": "*", "probe": "1"})["type"] == (
        "std_srvs/Trigger"
    )


@pytest.mark.slow
@pytest.mark.cases("GET /*", "*abcd", "")
@pytest.mark.parametrize(
    "data",
    [
        b"", b"\x01", b"\xff\xff\xff\xff", struct.pack("<I", 2**31), b"GET / HTTP/1.1\r\n\r\n" * 5,
        struct.pack("<II", 8, 0) + b"abcd", struct.pack("<II", 8, 99) + b"abcd",
        struct.pack("<II", 8, 4) + b"abcd",
        struct.pack("<II", 8, 4) + b"\xff\xfe=\xff",
    ],
)  # fmt: skip
def test_garbage_on_the_tcpros_port(node, data):
    throw(node.node._tcpros.address[1], data)


def throw(port, data):
    """Send something and read until the end, however it comes."""
    with (
        socket.create_connection(("127.0.0.1", port), timeout=5) as sock,
        contextlib.suppress(ConnectionError),
    ):
        sock.sendall(data)
        with contextlib.suppress(OSError):  # closed already
            sock.shutdown(socket.SHUT_WR)
        while sock.recv(4096):
            pass


@pytest.mark.slow
def test_random_bytes_on_both_ports(node, caplog):
    rng = np.random.default_rng(3)
    for port in (node.node._tcpros.address[1], node.node._rpc.port):
        for _ in range(150):
            data = rng.bytes(int(rng.integers(1, 400)))
            throw(port, struct.pack("<I", len(data)) + data if rng.random() < 0.5 else data)
    assert node.node.mistakes > 100
    assert len([r for r in caplog.records if "TCPROS" in r.getMessage()]) < 10  # each kind once


def test_requests_that_are_none(node):
    fields = {"callerid": "/x", "service": "/ask", "md5sum": "*", "persistent": "1"}
    with connect(node) as sock:
        sock.sendall(encode_header(fields))
        receive(sock)
        sock.sendall(struct.pack("<I", 3) + b"abc")  # an empty request has no bytes
        ok, size = sock.recv(1), struct.unpack("<I", sock.recv(4))[0]
        assert ok == b"\0" and b"3 bytes are no std_srvs/TriggerRequest" in sock.recv(size)
        sock.sendall(struct.pack("<I", 0))
        assert sock.recv(1) == b"\1"
    with connect(node) as sock:
        sock.sendall(encode_header(fields))
        receive(sock)
        sock.sendall(struct.pack("<I", 2**32 - 1))
        assert sock.recv(1) == b"\0"


def test_headers_read_what_they_write():
    fields = {"a": "1", "b": "x=y=z", "text": "żółw\n"}
    assert decode_header(encode_header(fields)[4:]) == fields
    with pytest.raises(WireError):
        decode_header(b"\x04\x00\x00\x00abcd")  # no '='
    with pytest.raises(WireError):
        decode_header((struct.pack("<I", 3) + b"a=b") * 100)


class BadPublisher:
    """A publisher on plain sockets that sends what it is told after its header."""

    def __init__(self, uri, topic, data, header=None):
        from xmlrpc.server import SimpleXMLRPCServer

        self.connections = 0
        self._data, self._header = data, header or subscriber(topic=topic)
        self._listening = socket.create_server(("127.0.0.1", 0))
        self._rpc = SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False)
        port = self._listening.getsockname()[1]
        self._rpc.register_function(lambda *_: [1, "", ["TCPROS", "127.0.0.1", port]], "requestTopic")
        self._threads = [
            threading.Thread(target=self._rpc.serve_forever, kwargs={"poll_interval": 0.02}),
            threading.Thread(target=self._serve),
        ]
        for thread in self._threads:
            thread.start()
        with ServerProxy(uri) as master:
            api = f"http://127.0.0.1:{self._rpc.server_address[1]}/"
            master.registerPublisher("/bad", topic, STRING, api)

    def _serve(self):
        while True:
            try:
                sock, _ = self._listening.accept()
            except OSError:
                return
            self.connections += 1
            with sock:
                receive(sock)
                sock.sendall(encode_header(self._header) + self._data)
                time.sleep(0.05)

    def close(self):
        self._rpc.shutdown()
        self._rpc.server_close()
        self._listening.shutdown(socket.SHUT_RDWR)
        self._listening.close()
        for thread in self._threads:
            thread.join()


GOOD = (lambda body: struct.pack("<I", len(body)) + body)(bytes(ros1_codec().encode(S.new(STRING, "good"))))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("data", "header", "said", "good"),
    [
        (struct.pack("<I", 4) + b"\xff\xff\xff\x7f" + GOOD, None, "are no std_msgs/String", True),
        (struct.pack("<I", 2**32 - 1), None, "announces a message of 4294967295 bytes", False),
        (GOOD, subscriber(md5sum="f" * 32), "was expected", False),
        (GOOD, {"error": "go away"}, "it refuses: go away", False),
        (GOOD, {"callerid": "/x"}, "its header has no type", False),
    ],
)
def test_publishers_that_send_nonsense(node, caplog, data, header, said, good):
    inbox = node.bus.subscribe("/in", STRING, queue_size=1000)
    bad = BadPublisher(node.node.master, "/in", data, header)
    try:
        eventually(lambda: bad.connections >= 2)  # it is tried again
        assert (getattr(inbox.get(0.2), "data", None) == "good") is good
    finally:
        bad.close()
    lines = [r.getMessage() for r in caplog.records if said in r.getMessage()]
    assert len(lines) == 1, lines  # logged once


def test_a_subscriber_that_stalls_delays_nobody_and_memory_stays_bounded(joined):
    graph = joined("a", queue_bytes=1 << 20, queue=50)
    inbox = joined("b").bus.subscribe("/big", "std_msgs/UInt8MultiArray", queue_size=2000)
    out = graph.bus.advertise("/big", "std_msgs/UInt8MultiArray")
    with connect(graph) as stalled:
        eventually(lambda: out.subscribers == 1)
        kind = "std_msgs/UInt8MultiArray"
        stalled.sendall(encode_header(subscriber(topic="/big", type=kind, md5sum=S.md5(kind))))
        receive(stalled)
        eventually(lambda: out.subscribers == 2)
        message = S.new(kind, data=np.zeros(100_000, np.uint8))
        slowest = 0.0
        for _ in range(300):
            began = time.perf_counter()
            out.publish(message)
            slowest = max(slowest, time.perf_counter() - began)
            assert inbox.get(5) is not None
        assert slowest < 5.0
        (link,) = (x for p in graph.node.publications() for x in p.links() if x.caller == "/x")
        assert link.dropped > 200 and link._waiting_bytes <= 1 << 20
        assert graph.status().dropped == link.dropped


@pytest.mark.slow
def test_a_thousand_connections_leave_nothing(node):
    threads = threading.active_count()
    for n in range(1000):
        with connect(node) as sock:
            if n % 3:
                sock.sendall(encode_header(subscriber()))
            if n % 3 == 2:
                receive(sock)
    eventually(lambda: node.out.subscribers == 1, 10)
    eventually(lambda: threading.active_count() <= threads, 10)
    assert len([x for p in node.node.publications() if p.topic == "/out" for x in p.links()]) == 1


def test_messages_that_cannot_be_encoded_are_said_once(node, caplog):
    late = node.bus.advertise("/late", STRING)
    with connect(node) as sock:
        eventually(lambda: "/late" in [p.topic for p in node.node.publications()])
        sock.sendall(encode_header(subscriber(topic="/late")))
        receive(sock)
        eventually(lambda: late.subscribers)
        for _ in range(3):
            late.publish(S.new(STRING, 5))
        late.publish(S.new(STRING, "fine"))
        assert sock.recv(100)[8:] == b"fine"
    assert sum("cannot be encoded" in r.getMessage() for r in caplog.records) == 1


def test_our_master_vanishes_and_returns(no_threads_left):
    from armcell.ros.ros1 import Ros1Master

    port = free_port()
    settings = Ros1Settings(master=f"http://127.0.0.1:{port}", own_master=False, timeout=2.0)
    bus, other = Bus(), Bus()
    bus.parameters.set("/kept", 1)
    out = bus.advertise("/out", STRING)
    bus.serve("/ask", "std_srvs/Trigger", lambda _: S.new("std_srvs/TriggerResponse", True, "yes"))
    master = Ros1Master(settings)
    master.start()
    with Ros1Graph(bus, settings) as graph, Ros1Graph(other, replace(settings, name="b")):
        inbox = other.subscribe("/out", STRING)
        eventually(lambda: out.subscribers)
        master.close()
        eventually(lambda: not graph.node.registrar.reachable)
        out.publish(S.new(STRING, "without a master"))  # what is connected stays connected
        assert inbox.get(2).data == "without a master"
        with pytest.raises(ServiceError):
            other.call("/ask", S.new("std_srvs/TriggerRequest"))
        bus.parameters.set("/kept", 2)
        with Ros1Master(settings):
            assert other.wait_for_service("/ask", 8)
            assert eventually(lambda: other.parameters.get("/kept", None)) == 2
            late = other.subscribe("/later", STRING)
            bus.advertise("/later", STRING, latch=True).publish(S.new(STRING, "new"))
            assert late.get(5).data == "new"
