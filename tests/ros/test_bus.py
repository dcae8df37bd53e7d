"""Topics, services, parameters and the clock of the in-process bus."""

import threading
import time

import pytest

from armcell.core import InputError, UnknownNameError
from armcell.ros import Bus, ServiceError, schema

TEXT = "std_msgs/String"


def text(value):
    return schema().new(TEXT, data=value)


def data(subscription, count, timeout=2.0):
    return [m.data for m in (subscription.get(timeout) for _ in range(count)) if m is not None]


def test_messages_arrive_in_order_at_every_subscriber():
    bus = Bus()
    first, second = bus.subscribe("chat", TEXT), bus.subscribe("/chat", "std_msgs/msg/String")
    publisher = bus.advertise("/chat/", TEXT)
    for i in range(5):
        publisher.publish(text(str(i)))
    assert data(first, 5) == data(second, 5) == list("01234")
    assert first.get(timeout=0) is None


def test_a_full_queue_drops_its_oldest_and_counts():
    bus = Bus()
    subscription = bus.subscribe("chat", TEXT, queue_size=3)
    publisher = bus.advertise("chat", TEXT)
    for i in range(10):
        publisher.publish(text(str(i)))
    assert data(subscription, 3) == ["7", "8", "9"]
    assert subscription.dropped == 7
    (info,) = bus.topics()
    assert (info.messages, info.dropped, info.publishers, info.subscribers) == (10, 7, 1, 1)


def test_latched_messages_reach_late_subscribers_until_the_publisher_leaves():
    bus = Bus()
    with bus.advertise("map", TEXT, latch=True) as publisher, bus.advertise("map", TEXT) as other:
        publisher.publish(text("old"))
        publisher.publish(text("new"))
        other.publish(text("not kept"))
        assert data(bus.subscribe("map", TEXT), 1) == ["new"]
    assert bus.subscribe("map", TEXT).get(timeout=0.01) is None


def test_a_callback_runs_in_its_own_thread_and_survives_its_own_failure(caplog):
    bus, seen, arrived = Bus(), [], threading.Event()

    def callback(message):
        seen.append((message.data, threading.current_thread()))
        if message.data == "bad":
            raise RuntimeError("no")
        if message.data == "end":
            arrived.set()

    subscription = bus.subscribe("chat", TEXT, callback)
    publisher = bus.advertise("chat", TEXT)
    for word in ("bad", "end"):
        publisher.publish(text(word))
    assert arrived.wait(2)
    assert [word for word, _ in seen] == ["bad", "end"]
    assert threading.current_thread() not in [t for _, t in seen]
    assert "a subscriber of /chat failed" in caplog.text
    subscription.close()
    assert not any(t.is_alive() for _, t in seen)


def test_joined_topics_come_through_one_queue_in_order():
    bus = Bus()
    both = bus.subscribe("a", TEXT, queue_size=100)
    both.join("b", "std_msgs/Int32")
    a, b = bus.advertise("a", TEXT), bus.advertise("b", "std_msgs/Int32")
    for i in range(20):
        a.publish(text(i))
        b.publish(schema().new("std_msgs/Int32", i))
    assert data(both, 40) == [i for i in range(20) for _ in range(2)]
    both.close()
    assert a.subscribers == b.subscribers == 0


def test_a_slow_callback_does_not_hold_up_the_publisher():
    bus, go = Bus(), threading.Event()
    bus.subscribe("chat", TEXT, lambda _: go.wait(60), queue_size=1)
    publisher = bus.advertise("chat", TEXT)
    start = time.monotonic()
    for _ in range(100):
        publisher.publish(text("x"))
    assert time.monotonic() - start < 30.0
    go.set()


def test_one_topic_one_type():
    bus = Bus()
    publisher = bus.advertise("chat", TEXT)
    with pytest.raises(InputError, match="carries std_msgs/String, not std_msgs/Float64"):
        bus.subscribe("chat", "std_msgs/Float64")
    with pytest.raises(InputError, match="carries std_msgs/String, not std_msgs/Float64"):
        publisher.publish(schema().new("std_msgs/Float64"))
    with pytest.raises(InputError, match="not str"):
        publisher.publish("hello")
    with pytest.raises(UnknownNameError):
        bus.advertise("other", "std_msgs/Strin")
    publisher.close()
    assert bus.topics() == []
    bus.subscribe("chat", "std_msgs/Float64")  # free again
    with pytest.raises(InputError, match="closed"):
        publisher.publish(text("x"))


@pytest.mark.parametrize("name", ["", "/", "a b", "1a", "a/2b", "ä", "a" * 300, "a\0"])
def test_names_ros_would_not_take(name):
    with pytest.raises(InputError, match="no topic or service name"):
        Bus().advertise(name, TEXT)


def test_many_threads_publish_and_join():
    bus, count, workers = Bus(), 300, 6
    total = bus.subscribe("chat", TEXT, queue_size=count * workers)

    def work():
        with bus.advertise("chat", TEXT, latch=True) as publisher:
            for i in range(count):
                publisher.publish(text(str(i)))
                bus.subscribe("chat", TEXT).close()

    threads = [threading.Thread(target=work) for _ in range(workers)]
    for t in threads:
        t.start()
    for t in threads:
        t.join(60)
    assert sorted(data(total, count * workers)) == sorted(
        str(i) for i in range(count) for _ in range(workers)
    )
    assert bus.topics()[0].subscribers == 1


def test_services():
    bus = Bus()
    request, response = schema().service("std_srvs/SetBool")
    with bus.serve("switch", "std_srvs/SetBool", lambda r: response(r.data, "done")):
        assert bus.call("/switch", request(True)).success
        assert bus.services() == {"/switch": "std_srvs/SetBool"}
        with pytest.raises(InputError, match="already served"):
            bus.serve("switch", "std_srvs/SetBool", lambda r: response())
        with pytest.raises(InputError, match="takes std_srvs/SetBoolRequest, not std_msgs/String"):
            bus.call("switch", text("x"))
    with pytest.raises(ServiceError, match="unknown service '/switch'"):
        bus.call("switch", request())
    with pytest.raises(UnknownNameError):
        bus.serve("switch", "std_srvs/SetBoo", lambda r: None)


def test_failing_and_wrongly_typed_handlers_are_service_errors():
    bus = Bus()
    request, _ = schema().service("std_srvs/Trigger")

    def fail(_):
        raise ZeroDivisionError("by zero")

    bus.serve("a", "std_srvs/Trigger", fail)
    bus.serve("b", "std_srvs/Trigger", lambda _: None)
    with pytest.raises(ServiceError, match="ZeroDivisionError: by zero"):
        bus.call("a", request())
    with pytest.raises(ServiceError, match="answered with NoneType"):
        bus.call("b", request())


def test_waiting_for_a_service():
    bus = Bus()
    assert not bus.wait_for_service("a", timeout=0.01)
    _, response = schema().service("std_srvs/Trigger")
    timer = threading.Timer(0.05, bus.serve, ("a", "std_srvs/Trigger", lambda _: response()))
    timer.start()
    assert bus.wait_for_service("a", timeout=5)


def test_parameters_are_values_and_namespaces():
    p = Bus().parameters
    p.set("/move_group/planning", {"time": 5.0, "attempts": 2})
    p.set("move_group/name", "panda")
    assert p.get("/move_group") == {"planning": {"time": 5.0, "attempts": 2}, "name": "panda"}
    assert p.get("/") == {"move_group": p.get("/move_group")}
    p.set("/move_group/planning", {"time": 1.0})
    assert p.get("/move_group/planning") == {"time": 1.0}
    assert "/move_group/planning" in p and "/move_group/planning/attempts" not in p
    p.set("/move_group", 3)
    assert p.get("/move_group") == 3 and p.names() == ["/move_group"]
    p.set("/move_group/a", 1)
    assert p.get("/move_group") == {"a": 1}
    p.delete("/move_group")
    assert p.get("/x", 7) == 7
    for read in (lambda: p.get("/x"), lambda: p.delete("/x")):
        with pytest.raises(UnknownNameError):
            read()


def test_the_clock_is_the_walls_or_a_simulations():
    bus = Bus()
    assert abs(bus.clock.now() - time.time()) < 1.0
    assert bus.clock.wait_until(time.time() + 0.02, timeout=5) and not bus.clock.wait_until(
        1e12, timeout=0.01
    )
    bus.clock.set(12.25)
    assert bus.header("world").stamp == schema().new("builtin_interfaces/Time", 12, 250_000_000)
    assert not bus.clock.wait_until(13.0, timeout=0.01)
    threading.Timer(0.05, bus.clock.set, (13.5,)).start()
    assert bus.clock.wait_until(13.0, timeout=5)
    with pytest.raises(InputError):
        bus.clock.set(float("nan"))


def test_a_transport_does_not_get_what_it_brought():
    bus, wire, other, got, heard = Bus(), object(), object(), [], []
    own = bus.advertise("/t", "std_msgs/Int32", latch=True, owner=wire)
    own.publish(schema().new("std_msgs/Int32", 1))
    bus.attach("/t", "std_msgs/Int32", got.append, owner=wire)
    bus.attach("/t", "std_msgs/Int32", heard.append, owner=other)
    own.publish(schema().new("std_msgs/Int32", 2))
    bus.advertise("/t", "std_msgs/Int32", latch=True).publish(schema().new("std_msgs/Int32", 3))
    assert [m.data for m in got] == [3] and [m.data for m in heard] == [1, 2, 3]
    (info,) = bus.topics(besides=wire)
    assert (info.publishers, info.subscribers, info.latched) == (1, 1, True)
    assert bus.topics()[0].publishers == 2


def test_who_comes_and_goes_is_told():
    bus = Bus()
    version = bus.wait_change(-1, 0)
    assert bus.wait_change(version, 0.02) == version
    with bus.advertise("/t", "std_msgs/Int32"):
        came = bus.wait_change(version, 1)
    assert came != version and bus.wait_change(came, 1) != came


def test_services_behind_a_wire_are_asked_last():
    bus, asked = Bus(), []

    def find(name):
        asked.append(name)
        return (
            (lambda request: schema().new("std_srvs/TriggerResponse", True, "far"))
            if name == "/far"
            else None
        )

    bus.add_service_finder(find)
    with bus.serve(
        "/near", "std_srvs/Trigger", lambda _: schema().new("std_srvs/TriggerResponse", True, "near")
    ):
        assert bus.call("near", schema().new("std_srvs/TriggerRequest")).message == "near" and not asked
    assert bus.wait_for_service("/far", 0.5) and not bus.wait_for_service("/none", 0.15)
    assert bus.call("/far", schema().new("std_srvs/TriggerRequest")).message == "far"
    bus.remove_service_finder(find)
    with pytest.raises(ServiceError, match="unknown service '/far'"):
        bus.call("/far", schema().new("std_srvs/TriggerRequest"))
