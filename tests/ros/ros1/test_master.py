"""Our master, asked through Python's own XML-RPC client; what rosmaster answers is in test_interop."""

from __future__ import annotations

import http.client
import threading
from xmlrpc.client import Fault, MultiCall, ServerProxy
from xmlrpc.server import SimpleXMLRPCServer

import pytest
from tests.ros.ros1.conftest import eventually, free_port

from armcell.core import InputError
from armcell.ros.ros1 import Ros1Master, Ros1Settings
from armcell.ros.ros1.parameters import ParameterTree, subscriber_update

A, B = "http://127.0.0.1:1/", "http://127.0.0.1:2/"


@pytest.fixture
def uri(no_threads_left):
    with Ros1Master(Ros1Settings(master=f"http://127.0.0.1:{free_port()}")) as master:
        yield master.uri


@pytest.fixture
def master(uri):
    with ServerProxy(uri) as proxy:
        yield proxy


class Listening:
    """A node that writes down what the master tells it."""

    def __init__(self):
        self.heard = []
        self.server = SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False)
        for name in ("publisherUpdate", "paramUpdate", "shutdown"):
            self.server.register_function(self._note(name), name)
        self.uri = f"http://127.0.0.1:{self.server.server_address[1]}/"
        self.thread = threading.Thread(target=self.server.serve_forever, kwargs={"poll_interval": 0.02})
        self.thread.start()

    def _note(self, name):
        def note(*arguments):
            self.heard.append((name, *arguments))
            return [1, "", 0]

        return note

    def close(self):
        self.server.shutdown()
        self.server.server_close()
        self.thread.join()


@pytest.fixture
def node(no_threads_left):
    node = Listening()
    yield node
    node.close()


def test_publishers_and_subscribers_find_each_other(master, node):
    assert master.registerSubscriber("/b", "/chat", "*", node.uri) == [1, "Subscribed to [/chat]", []]
    answer = master.registerPublisher("/a", "/chat", "std_msgs/String", A)
    assert answer == [1, "Registered [/a] as publisher of [/chat]", [node.uri]]
    assert eventually(lambda: node.heard)[0] == ("publisherUpdate", "/master", "/chat", [A])
    assert master.getPublishedTopics("/x", "")[2] == [["/chat", "std_msgs/String"]]
    assert master.getPublishedTopics("/x", "/other")[2] == []
    assert master.getTopicTypes("/x")[2] == [["/chat", "std_msgs/String"]]
    assert master.getSystemState("/x")[2] == [[["/chat", ["/a"]]], [["/chat", ["/b"]]], []]
    assert master.lookupNode("/x", "/a") == [1, "node api", A]
    assert master.unregisterPublisher("/a", "/chat", B)[2] == 0  # of somebody else
    assert master.unregisterPublisher("/a", "/chat", A)[2] == 1
    eventually(lambda: node.heard[-1] == ("publisherUpdate", "/master", "/chat", []))
    assert master.lookupNode("/x", "/a")[0] == -1
    assert master.getTopicTypes("/x")[2] == [["/chat", "std_msgs/String"]]  # it is remembered


def test_names_are_resolved_in_the_callers_namespace(master):
    master.registerPublisher("/left/arm", "chat", "std_msgs/String", A)
    master.registerPublisher("/left/arm", "~own", "std_msgs/String", A)
    master.setParam("/left/arm", "speed", 3)
    assert {t for t, _ in master.getPublishedTopics("/x", "")[2]} == {"/left/chat", "/left/arm/own"}
    assert master.getParam("/x", "/left/speed")[2] == 3


def test_the_newest_of_two_services_serves(master):
    assert master.lookupService("/x", "/cut") == [-1, "no provider", ""]
    master.registerService("/a", "/cut", "rosrpc://127.0.0.1:3", A)
    master.registerService("/b", "/cut", "rosrpc://127.0.0.1:4", B)
    assert master.lookupService("/x", "/cut")[2] == "rosrpc://127.0.0.1:4"
    assert master.unregisterService("/a", "/cut", "rosrpc://127.0.0.1:3")[2] == 0
    assert master.unregisterService("/b", "/cut", "rosrpc://127.0.0.1:4")[2] == 1
    assert master.lookupService("/x", "/cut")[0] == -1


def test_of_two_nodes_of_one_name_the_older_is_asked_to_end(master, node):
    master.registerPublisher("/a", "/old", "std_msgs/String", node.uri)
    master.registerPublisher("/a", "/new", "std_msgs/String", B)
    name, who, reason = eventually(lambda: node.heard)[0]
    assert (name, who) == ("shutdown", "/master") and "new node registered with same name" in reason
    assert master.getSystemState("/x")[2][0] == [["/new", ["/a"]]]


def test_parameters(master, node):
    c = "/ns/node"
    assert master.getParam(c, "/none") == [-1, "Parameter [/none] is not set", 0]
    assert master.setParam(c, "/arm", {"speed": 1.5, "limits": {"a-b": [1, 2], "": True}})[0] == 1
    assert master.getParam(c, "/arm/limits/a-b")[2] == [1, 2]
    assert master.hasParam(c, "/arm/limits")[2] is True
    assert master.hasParam(c, "/arm/limits/c")[2] is False
    assert master.searchParam(c, "arm/other")[2] == "/arm/other"  # its first part is there
    assert master.searchParam(c, "leg")[0] == -1
    assert set(master.getParamNames(c)[2]) == {"/run_id", "/arm/speed", "/arm/limits/a-b", "/arm/limits/"}
    assert master.subscribeParam("/n", node.uri, "/arm")[2]["speed"] == 1.5
    master.setParam(c, "/arm/speed", 2)
    master.deleteParam(c, "/arm")
    assert eventually(lambda: len(node.heard) >= 2 and node.heard)[:2] == [
        ("paramUpdate", "/master", "/arm/speed/", 2), ("paramUpdate", "/master", "/arm/", {}),
    ]  # fmt: skip
    assert master.deleteParam(c, "/arm") == [-1, "parameter [/arm] is not set", 0]
    assert master.unsubscribeParam("/n", node.uri, "/arm")[0] == 1


def test_what_a_parameters_subscriber_hears():
    assert subscriber_update("/a", "/b", 1) is None
    assert subscriber_update("/a/b", "/a", {"b": 3}) == ("/a/b/", 3)
    assert subscriber_update("/a/b", "/a", {"c": 3}) == ("/a/b/", {})
    assert subscriber_update("/a/b", "/a/b/c", 5) == ("/a/b/c/", 5)


def test_a_value_becomes_a_namespace():
    tree = ParameterTree()
    tree.set("/a", 1)
    tree.set("/a/b", 2)
    assert tree.get("/a") == {"b": 2} and tree.names() == ["/a/b"]
    with pytest.raises(KeyError):
        tree.get("/a/b/c")
    with pytest.raises(KeyError):
        tree.delete("/")
    with pytest.raises(ValueError, match="root"):
        tree.set("/", 3)
    tree.set("/", {"x": 1})
    assert tree.get("/") == {"x": 1}


def test_wrong_calls_are_answered_as_the_real_one_does(master):
    assert master.getPid() == [-1, "missing required caller_id parameter", -1]
    assert master.getPid(3) == [-1, "caller_id must be a string", -1]
    assert master.registerPublisher("/a", "/t") == [-1, "Error: bad call arity", []]
    assert master.registerPublisher("/a", "bad name", "x/Y", A)[0] == -1
    assert master.registerPublisher("/a", "/t", "x/Y", "no uri") == [
        -1, "ERROR: parameter [caller_api] is not an XMLRPC URI", [],
    ]  # fmt: skip
    assert master.setParam("/a", "", 1)[0] == -1
    with pytest.raises(Fault, match="not supported"):
        master.somethingElse("/a")


def test_several_calls_in_one(master):
    many = MultiCall(master)
    many.setParam("/a", "/x", 1)
    many.getParam("/a", "/x")
    assert [answer[2] for answer in many()] == [0, 1]


BOMB = (
    '<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a "aaaa">]>'
    "<methodCall><methodName>&a;</methodName></methodCall>"
)


@pytest.mark.parametrize(
    ("body", "headers", "status"),
    [
        (b"", {}, 200),
        (b"\x00\xff garbage" * 10, {}, 200),
        (BOMB.encode(), {}, 200),
        (b"<methodCall><params><param><value><int>zwei</int></value></param></params></methodCall>", {}, 200),
        (b"x", {"Content-Length": "999999999999"}, 413),
        (b"x", {"Content-Length": "-3"}, 411),
        (b"x", {"Content-Encoding": "gzip"}, 415),
    ],
)
def test_garbage_is_refused_and_the_master_goes_on(uri, master, body, headers, status):
    connection = http.client.HTTPConnection(uri[7:-1], timeout=3)
    connection.request("POST", "/RPC2", body, headers)
    reply = connection.getresponse()
    assert reply.status == status
    if status == 200:
        assert b"<fault>" in reply.read()
    connection.close()
    assert master.getUri("/x") == [1, "", uri]


def test_a_taken_port_is_said(uri):
    second = Ros1Master(Ros1Settings(master=uri))
    with pytest.raises(InputError, match="another program has the port"):
        second.start()
    second.close()
