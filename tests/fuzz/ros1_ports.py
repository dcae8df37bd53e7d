"""The ports of a ROS 1 node and master: TCPROS (subscribers and service clients), XML-RPC (slave, master)."""

from __future__ import annotations

import contextlib
import socket
import struct
import xmlrpc.client
from collections.abc import Iterator

from tests.fuzz.corpus import Corpus
from tests.fuzz.edges import Edges

from armcell.ros import Bus, Ros1Graph, Ros1Settings, schema
from armcell.ros.codec import ros1_codec
from armcell.ros.ros1 import sockets
from armcell.ros.ros1.xmlrpc import call_method

STRING = "std_msgs/String"
SERVICES = ("std_srvs/SetBool", "moveit_msgs/GetPositionIK", "moveit_msgs/ApplyPlanningScene")
REQUESTS = 20  # of one connection
CALLS = 50  # of one connection
HANG = 10.0  # [s] a connection that is neither answered nor closed


class _Graph:
    """A node with a topic and services, its master, and another node that listens."""

    def __init__(self, seed: int, edges: Edges):
        self.corpus, self._edges, self.frames = Corpus(seed), edges, 0

    @contextlib.contextmanager
    def opened(self) -> Iterator[None]:
        bus, other = Bus(), Bus()
        for name in SERVICES:
            _, response = schema().service(name)
            bus.serve(f"/{name.partition('/')[2]}", name, lambda request, make=response: make())
        own = Ros1Settings("a", master="http://127.0.0.1:0", own_master=True)
        with Ros1Graph(bus, own) as self._node, bus.advertise("/out", STRING, latch=True) as self._out:
            joined = Ros1Settings("b", master=self._node.node.master, own_master=False)
            with Ros1Graph(other, joined), other.subscribe("/out", STRING) as self._inbox:
                self._out.publish(schema().new(STRING, "begin"))
                assert self._inbox.get(HANG) is not None
                yield

    def _learn(self, before: int, item: object) -> None:
        if self._edges.count > before:
            self.corpus.keep(item)


class Tcpros(_Graph):
    """One `send` is a connection: a sockets, then requests where it is a service's."""

    name = "TCPROS port, ROS 1"
    share = 0.1

    def check(self) -> None:
        """The other node still hears what is published, whoever else connects."""
        text = schema().new(STRING, str(self.frames))
        self._out.publish(text)
        assert self._inbox.get(HANG) == text, "the other node's message did not arrive"

    def send(self) -> None:
        corpus = self.corpus
        pieces = corpus.pick(corpus.kept) if corpus.kept and corpus.chance(0.5) else self._drawn()
        at = corpus.rng.randrange(len(pieces))
        pieces = [*pieces[:at], corpus.damage(pieces[at]), *pieces[at + 1 :]]
        before, calls = self._edges.count, self._calls()
        with (
            socket.create_connection(self._node.node._tcpros.address, timeout=HANG) as raw,
            contextlib.suppress(ConnectionError),
        ):
            for piece in pieces:
                raw.sendall(piece)
            with contextlib.suppress(OSError):  # closed already
                raw.shutdown(socket.SHUT_WR)
            while raw.recv(1 << 16):
                pass
        self.frames += 1 + self._calls() - calls
        self._learn(before, pieces)

    def _calls(self) -> int:
        return sum(service.calls for service in self._node.node._services.values())

    def _drawn(self) -> list[bytes]:
        corpus = self.corpus
        if corpus.chance(0.2):
            fields = {
                "callerid": "/x", "topic": corpus.pick(("/out", "/none")),
                "type": corpus.pick((STRING, "*", "a/B")),
                "md5sum": corpus.pick((schema().md5(STRING), "*", "0")),
            }  # fmt: skip
            requests = []
        else:
            kind = corpus.pick(SERVICES)
            fields = {
                "callerid": "/x", "service": f"/{kind.partition('/')[2]}", "md5sum": corpus.pick("****0"),
                "persistent": corpus.pick("11110"),
            }  # fmt: skip
            bodies = [bytes(ros1_codec().encode(corpus.message(f"{kind}Request"))) for _ in range(2)]
            bodies = [corpus.damage(corpus.pick(bodies)) for _ in range(REQUESTS)]
            requests = [struct.pack("<I", len(body)) + body for body in bodies]
        extra = {"probe": "1"} if corpus.chance(0.1) else {}
        return [sockets.encode_header(fields | extra), *requests]


class XmlRpc(_Graph):
    """One `send` is a connection with many calls, to the node's or the master's port."""

    name = "XML-RPC ports, ROS 1"
    share = 0.05

    def check(self) -> None:
        """Another client is answered."""
        assert call_method(self._node.node.master, "getUri", "/me", timeout=HANG)
        assert call_method(self._node.node.uri, "getMasterUri", "/me", timeout=HANG) == self._node.node.master

    def send(self) -> None:
        assert self._node.master is not None
        server = self.corpus.pick((self._node.node._rpc, self._node.master._server))
        with (
            socket.create_connection(("127.0.0.1", server.port), timeout=HANG) as raw,
            contextlib.suppress(ConnectionError),
        ):
            answers = raw.makefile("rb")
            for _ in range(CALLS):
                body = self._body(server)
                before = self._edges.count
                head = b"POST /RPC2 HTTP/1.1\r\nContent-Length: %d\r\n\r\n" % len(body)
                damaged = self.corpus.chance(0.02)
                raw.sendall((self.corpus.damage(head) if damaged else head) + body)
                self.frames += 1
                if damaged:  # how many bytes are a request is anybody's guess
                    raw.shutdown(socket.SHUT_WR)
                    answers.read()
                    return
                length = 0
                while (line := answers.readline()) not in (b"\r\n", b""):
                    if line.lower().startswith(b"content-length:"):
                        length = int(line.partition(b":")[2])
                answers.read(length)
                self._learn(before, body)
                if not line:
                    return

    def _body(self, server) -> bytes:
        corpus = self.corpus
        if corpus.kept and corpus.chance(0.5):
            return corpus.damage(corpus.pick(corpus.kept))
        if corpus.chance(0.1):
            calls = [{"methodName": m, "params": list(a)} for m, a in (self._call(server) for _ in range(3))]
            body = xmlrpc.client.dumps((calls,), "system.multicall").encode()
        else:
            method, arguments = self._call(server)
            body = xmlrpc.client.dumps(arguments, method).encode()
        return corpus.damage(body) if corpus.chance(0.3) else body

    def _call(self, server) -> tuple[str, tuple]:
        corpus = self.corpus
        method = corpus.pick([*server._methods, "system.listMethods", "none"])
        caller = corpus.pick(("/x", "/y", "", 5))
        values = (
            "/out", "/none", "~p", "a b", "", "/p/q", STRING, "*", "http://127.0.0.1:1/", "rosrpc://127.0.0.1:1",
            5, 2.5, True, [], {"a": {"b": 1}}, ["http://127.0.0.1:1/"], [["TCPROS"]], "x" * 300,
        )  # fmt: skip
        return method, (caller, *(corpus.pick(values) for _ in range(corpus.rng.randint(0, 4))))
