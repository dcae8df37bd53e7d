"""What the master is told, when its words overtake one another and when it is exchanged unnoticed."""

from __future__ import annotations

from dataclasses import replace

from tests.ros.ros1.conftest import eventually, free_port

from armcell.ros import Bus, schema
from armcell.ros.ros1 import Ros1Graph, Ros1Master, Ros1Settings, registrar
from armcell.ros.ros1.registrar import Kind, Registrar

S = schema()
STRING = "std_msgs/String"


def test_news_that_overtakes_the_answer_to_a_registration_is_not_lost(monkeypatch):
    heard, asked = [], []

    def ask(master, method, *arguments, timeout):
        asked.append(method)
        if method == "registerSubscriber" and asked.count(method) == 1:
            told.update_publishers("/t", ["http://new/"])  # the answer was made before, and comes after
            return []
        return ["http://new/"]

    monkeypatch.setattr(registrar, "call_method", ask)
    told = Registrar("http://m/", "/n", lambda: "http://n/", 1.0, lambda *what: heard.append(what), print)
    told.register(Kind.SUBSCRIBER, "/t", STRING)
    told.start()
    assert told.wait(5)
    told.close()
    assert heard[-1] == ("/t", ["http://new/"]) and asked.count("registerSubscriber") == 2


def test_a_master_that_is_exchanged_between_two_looks_is_told_everything(monkeypatch, no_threads_left):
    monkeypatch.setattr(registrar, "CHECK_PERIOD", 1000.0)  # only what is new makes the node look
    settings = Ros1Settings(master=f"http://127.0.0.1:{free_port()}", own_master=False, timeout=2.0)
    buses = [Bus(), Bus()]
    old = buses[0].advertise("/old", STRING)
    with Ros1Master(settings):
        graphs = [Ros1Graph(bus, replace(settings, name=f"n{i}")) for i, bus in enumerate(buses)]
        for graph in graphs:
            graph.start()
    try:
        with Ros1Master(settings):
            inboxes = [buses[1].subscribe(topic, STRING) for topic in ("/new", "/old")]
            buses[0].advertise("/new", STRING, latch=True).publish(S.new(STRING, "new"))
            assert inboxes[0].get(5).data == "new"
            eventually(lambda: old.subscribers)
            old.publish(S.new(STRING, "old"))
            assert inboxes[1].get(5).data == "old"
    finally:
        for graph in graphs:
            graph.close()
