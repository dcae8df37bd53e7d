"""The contract of every registered transport. A new transport is tested by being registered."""

from __future__ import annotations

import importlib.util
import threading

import pytest

from armcell.core import InputError, UnknownNameError
from armcell.ros import Bus
from armcell.ros.transports import split_address, transports

needs_dds = pytest.mark.skipif(importlib.util.find_spec("cyclonedds") is None, reason="needs cyclonedds")
ADDRESSES = {"tcp": "127.0.0.1:0", "ros2": "87"}
NAMES = [pytest.param(n, marks=needs_dds) if n == "ros2" else n for n in transports]


@pytest.fixture(autouse=True)
def own_master(monkeypatch, unused_port):
    monkeypatch.setenv("ROS_MASTER_URI", f"http://127.0.0.1:{unused_port}")
    monkeypatch.delenv("ROS_IP", raising=False)


@pytest.fixture
def unused_port():
    import socket

    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_it_opens_on_this_machine_only_and_leaves_nothing(name):
    before = set(threading.enumerate())
    transport = transports[name](Bus(), ADDRESSES.get(name, ""))
    transport.reserve()
    transport.start()
    assert transport.ready_message() and "\n" not in transport.ready_message()
    assert transport.status_text() and "\n" not in transport.status_text()
    if name != "ros2":  # DDS also listens for discovery
        assert list(transport.endpoints()) and all(e.is_local for e in transport.endpoints())
    transport.close()
    transport.close()
    for thread in set(threading.enumerate()) - before:
        thread.join(10.0)
        assert not thread.is_alive() or thread.daemon, thread


@pytest.mark.parametrize("name", NAMES)
def test_the_constructor_opens_nothing(name):
    before = set(threading.enumerate())
    transport = transports[name](Bus(), ADDRESSES.get(name, ""))
    assert set(threading.enumerate()) == before
    transport.close()


def test_a_port_in_use_is_an_error():
    first = transports["tcp"](Bus(), "127.0.0.1:0")
    first.reserve()
    (endpoint,) = first.endpoints()
    second = transports["tcp"](Bus(), f"127.0.0.1:{endpoint.port}")
    with pytest.raises(InputError, match="cannot listen"):
        second.reserve()
    first.close()


def test_addresses():
    assert split_address("", 5) == ("127.0.0.1", 5) and split_address("h:7", 5) == ("h", 7)
    assert split_address(":0", 5) == ("127.0.0.1", 0)
    for wrong in ("h:x", "h:-1", "h:70000"):
        with pytest.raises(InputError, match="no valid port"):
            split_address(wrong, 5)
    with pytest.raises(UnknownNameError, match="ros1, ros2, tcp"):
        transports["tpc"]
