"""Faults of a tree of frames: each kind is found and named, and a sound tree has none."""

import pytest

from armcell.core import SE3
from armcell.ros import Bus, schema
from armcell.ros.convert import transform_message
from armcell.ros.tf_monitor import TfMonitor, subscribe_monitor

S = schema()


def message(pairs, stamp=10.0):
    header = S.new("std_msgs/Header")
    found = []
    for parent, child in pairs:
        header = S.new("std_msgs/Header", frame_id=parent)
        header.stamp = S.message("builtin_interfaces/Time").from_sec(stamp)
        found.append(transform_message(S, header, child, SE3.identity()))
    return S.new("tf2_msgs/TFMessage", found)


def monitored(*pairs, stamp=10.0, now=10.0, expected=(), static=False):
    monitor = TfMonitor(expected)
    monitor.add(message(pairs, stamp), now, static)
    return monitor


def test_a_sound_tree_has_no_faults():
    monitor = monitored(("world", "base"), ("base", "arm"), expected=("world", "base", "arm"))
    monitor.add(message([("world", "base"), ("base", "arm")], 10.5), 10.5)
    assert monitor.faults(10.6) == []
    assert monitor.lines(10.6) == ["world", "  base  (2 Hz, 0.10 s old)", "    arm  (2 Hz, 0.10 s old)"]


@pytest.mark.parametrize(
    "monitor, now, words",
    [
        (monitored(("world", "a"), ("map", "a")), 10.0, "a has two parents: map and world"),
        (monitored(("a", "b"), ("b", "a")), 10.0, "cycle: a -> b -> a"),
        (monitored(("world", "a"), ("map", "b")), 10.0, "2 trees, not one: map, world"),
        (monitored(("world", "a")), 13.0, "a is stale: no transform for 3.0 s"),
        (monitored(("world", "a"), stamp=4.0), 10.0, "a: its transforms are 6.0 s old"),
        (monitored(("world", "a"), stamp=16.0), 10.0, "a: its transforms are 6.0 s ahead of the clock"),
        (monitored(("world", "a"), expected=("world", "tool")), 10.0, "the cell's frames tool are missing"),
        (monitored(("a", "a")), 10.0, "a is its own parent"),
    ],
)
def test_each_fault_is_named(monitor, now, words):
    assert any(fault.startswith(words) for fault in monitor.faults(now)), monitor.faults(now)


def test_static_frames_do_not_get_stale():
    assert monitored(("world", "a"), static=True).faults(1000.0) == []


@pytest.mark.parametrize(
    "field, value, words", [("w", 2.0, "the length 2.000"), ("x", float("nan"), "finite")]
)
def test_bad_numbers(field, value, words):
    monitor, bad = TfMonitor(), message([("world", "a")])
    setattr(bad.transforms[0].transform.rotation, field, value)
    monitor.add(bad, 10.0)
    assert words in monitor.faults(10.0)[0]


def test_it_listens_to_a_bus():
    bus, monitor = Bus(), TfMonitor()
    bus.clock.set(10.0)
    bus.advertise("/tf_static", "tf2_msgs/TFMessage", latch=True).publish(message([("world", "a")]))
    members = subscribe_monitor(monitor, bus)
    for _ in range(500):
        if "a" in monitor.frames:
            break
        bus.wait_change(bus.wait_change(-1, 0), 0.01)
    assert monitor.frames["a"].static
    for member in members:
        member.close()
