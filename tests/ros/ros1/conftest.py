"""A graph on free ports, and a look at what is left running after it."""

from __future__ import annotations

import socket
import threading
import time

import pytest

from armcell.ros import Bus
from armcell.ros.ros1 import Ros1Graph, Ros1Settings


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as free:
        return free.getsockname()[1]


def eventually(what, seconds=5.0):
    """Wait until something is true; its value."""
    end = time.monotonic() + seconds
    while not (value := what()) and time.monotonic() < end:
        time.sleep(0.01)
    assert value, "did not happen in time"
    return value


@pytest.fixture
def no_threads_left():
    before = set(threading.enumerate())
    yield
    left = eventually_gone(before)
    assert not left, f"still running: {[t.name for t in left]}"


def eventually_gone(before):
    end = time.monotonic() + 5.0
    while time.monotonic() < end:
        left = [t for t in threading.enumerate() if t not in before]
        if not left:
            return []
        time.sleep(0.02)
    return left


@pytest.fixture
def master_uri():
    return f"http://127.0.0.1:{free_port()}"


@pytest.fixture
def joined(master_uri, no_threads_left):
    """Makes graphs that share a master: the first one's own, or the one that `master_uri` names."""
    made: list[Ros1Graph] = []

    def make(name: str, bus: Bus | None = None, **settings) -> Ros1Graph:
        settings.setdefault("own_master", None)
        graph = Ros1Graph(bus or Bus(), Ros1Settings(name=name, master=master_uri, timeout=2.0, **settings))
        graph.start()
        made.append(graph)
        return graph

    yield make
    for graph in reversed(made):
        graph.close()
