"""Services over ROS-TCP, both ways."""

import threading
import time

import pytest
from tests.ros.tcp_helpers import (
    IDS,
    MODES,
    codec,
    wait_for,
)
from tests.ros.unity_like import UnityLike

from armcell.ros import ServiceError, schema
from armcell.ros.codec import ros1_codec
from armcell.ros.tcp import RosTcpServer, ServerSettings


@pytest.mark.parametrize("ros2", MODES, ids=IDS)
def test_unity_calls_a_service_of_the_bus(bus, server, ros2):
    request, response = schema().service("std_srvs/SetBool")
    bus.serve("/switch", "std_srvs/SetBool", lambda r: response(r.data, "done"))
    with UnityLike(server.address, ros2) as unity:
        unity.register("__ros_service", "/switch", "std_srvs/SetBool")
        numbers = [unity.call("/switch", codec(ros2).encode(request(on))) for on in (True, False)]
        answers = {}
        for _ in range(2):
            number = unity.read_until("__response")["srv_id"]
            name, body = unity.read()  # the very next frame
            assert name == "/switch"
            answers[number] = codec(ros2).decode("std_srvs/SetBoolResponse", body).success
        assert answers == dict(zip(numbers, (True, False)))


def test_a_slow_service_holds_up_neither_topics_nor_other_services(bus, server):
    _, response = schema().service("std_srvs/Trigger")
    go = threading.Event()

    def slow(_):
        go.wait(5)
        return response(True, "slow")

    bus.serve("/slow", "std_srvs/Trigger", slow)
    bus.serve("/quick", "std_srvs/Trigger", lambda _: response(True, "quick"))
    with UnityLike(server.address) as unity:
        slow_number = unity.call("/slow", b"")
        quick_number = unity.call("/quick", b"")
        assert unity.read_until("__response")["srv_id"] == quick_number
        go.set()
        assert unity.read_until("__response")["srv_id"] == slow_number


@pytest.mark.parametrize("how", ["fails", "unknown", "bad request", "wrong type"])
def test_a_failed_service_is_answered_all_the_same(bus, server, how):
    _, response = schema().service("std_srvs/SetBool")

    def fail(_):
        raise ZeroDivisionError("by zero")

    bus.serve("/switch", "std_srvs/SetBool", fail if how == "fails" else lambda r: response(True))
    with UnityLike(server.address) as unity:
        if how != "unknown":
            kind = "std_srvs/Trigger" if how == "wrong type" else "std_srvs/SetBool"
            unity.register("__ros_service", "/switch", kind)
        name = "/nobody" if how == "unknown" else "/switch"
        number = unity.call(name, b"\1\2\3" if how == "bad request" else b"\1")
        error = unity.read_until("__error")["text"]
        expected = {
            "fails": "ZeroDivisionError: by zero", "unknown": "unknown service",
            "bad request": "3 bytes are no",
            "wrong type": "is of type std_srvs/SetBool, not std_srvs/Trigger",
        }[how]  # fmt: skip
        assert expected in error
        assert unity.read_until("__response")["srv_id"] == number
        name_back, body = unity.read()
        assert name_back == name
        if how in ("fails", "bad request"):
            assert not ros1_codec().decode("std_srvs/SetBoolResponse", body).success


def serve_like_unity(unity, ros2, count, delay=0.0):
    """Answers service requests in a thread, as the connector's main loop does."""

    def run():
        for _ in range(count):
            number = unity.read_until("__request")["srv_id"]
            name, body = unity.read()
            data = codec(ros2).decode("std_srvs/SetBoolRequest", body).data
            time.sleep(delay)
            unity.command("__response", srv_id=number)
            answer = schema().new("std_srvs/SetBoolResponse", success=data, message=name)
            unity.message(name, codec(ros2).encode(answer))

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    return thread


@pytest.mark.parametrize("ros2", MODES, ids=IDS)
def test_the_bus_calls_a_service_of_unity(bus, server, ros2):
    request, _ = schema().service("std_srvs/SetBool")
    with UnityLike(server.address, ros2) as unity:
        for _ in range(2):
            unity.register("__unity_service", "/grip", "std_srvs/SetBool")
        assert bus.wait_for_service("/grip", 5)
        serve_like_unity(unity, ros2, 2)
        assert bus.call("/grip", request(True)).success
        assert bus.call("/grip", request(False)).message == "/grip"


def test_a_service_of_unity_that_went_or_hangs_fails_in_time(bus):
    request, _ = schema().service("std_srvs/SetBool")
    with RosTcpServer(bus, ServerSettings(port=0, service_timeout=0.2)) as server:
        unity = UnityLike(server.address)
        unity.register("__unity_service", "/grip", "std_srvs/SetBool")
        assert bus.wait_for_service("/grip", 5)
        with pytest.raises(ServiceError, match=r"gave no answer in 0\.2 s"):
            bus.call("/grip", request(True))
    with RosTcpServer(bus, ServerSettings(port=0, service_timeout=30)) as server:
        unity = UnityLike(server.address)
        unity.register("__unity_service", "/grip", "std_srvs/SetBool")
        assert bus.wait_for_service("/grip", 5)
        threading.Timer(0.1, unity.close).start()
        start = time.monotonic()
        with pytest.raises(ServiceError, match="went away"):
            bus.call("/grip", request(True))
        assert time.monotonic() - start < 20


def test_a_late_answer_and_one_to_nobody_are_told_and_change_nothing(bus, server):
    with UnityLike(server.address) as unity:
        unity.command("__response", srv_id=7)
        unity.message("/grip", b"\0")
        assert "for which no caller waits" in unity.read_until("__error")["text"]
        unity.command("__ping", request_time=1)
        unity.read_until("__ping_response")


def test_the_newer_of_two_servers_of_a_service_wins(bus, server):
    """Unity started again while its old connection still hangs."""
    request, _ = schema().service("std_srvs/SetBool")
    with UnityLike(server.address) as old, UnityLike(server.address) as new:
        old.register("__unity_service", "/grip", "std_srvs/SetBool")
        assert bus.wait_for_service("/grip", 5)
        new.register("__unity_service", "grip", "std_srvs/SetBool")
        assert "now served by" in old.read_until("__warn")["text"]
        wait_for(lambda: "/grip" in bus.services())
        serve_like_unity(new, False, 1)
        assert bus.call("/grip", request(True)).success


def test_a_service_of_this_program_is_not_taken_over(bus, server):
    _, response = schema().service("std_srvs/SetBool")
    bus.serve("/grip", "std_srvs/SetBool", lambda r: response())
    with UnityLike(server.address) as unity:
        unity.register("__unity_service", "/grip", "std_srvs/SetBool")
        assert "already served" in unity.read_until("__error")["text"]
