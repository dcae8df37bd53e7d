"""`armcell tf`: show the frame tree of a cell or a running system, with ages and faults."""

from __future__ import annotations

import threading
from contextlib import ExitStack
from typing import Any

import typer

from armcell import _interrupts
from armcell.cli.console import console, err
from armcell.cli.ros_options import DOMAIN
from armcell.core import InputError

EXAMPLES = """Examples:

  armcell tf panda_pick                            what `armcell serve` would publish

  armcell tf panda_pick --connect 127.0.0.1:10000  a running ROS-TCP endpoint, against the cell

  armcell tf panda_pick --ros1                     a ROS 1 graph; with --ros2 a domain
"""


def tf(
    cell: str = typer.Argument(..., help="The cell whose frames have to be there (see `armcell cells`)."),
    connect: str | None = typer.Option(None, metavar="HOST:PORT", help="Listen at a ROS-TCP endpoint."),
    ros1: bool = typer.Option(False, "--ros1", help="Listen in the ROS 1 graph at ROS_MASTER_URI."),
    ros2: bool = typer.Option(False, "--ros2", help="Listen in a ROS 2 domain (extra ros2)."),
    domain: int | None = DOMAIN,
    seconds: float = typer.Option(2.0, "--for", metavar="SECONDS", min=0.2, help="How long to listen."),
) -> int:
    """Print the tree of tf frames with rates and ages, and then its faults.
    The exit status is 1 if there are faults.

    Faults: missing frames, two parents, cycles, several trees, stale frames, wrong stamps, bad numbers.
    Without an address, the cell itself runs for the given time (mode fake).
    """
    if sum((connect is not None, ros1, ros2)) > 1:
        raise InputError("where to listen?", hint="give one of --connect, --ros1, --ros2")
    from armcell.cell import load
    from armcell.ros.tf_monitor import TfMonitor, subscribe_monitor

    loaded = load(cell)
    monitor = TfMonitor(tuple(loaded.model.links))
    with ExitStack() as stack:
        bus = _joined(stack, loaded, connect, ros1, ros2, domain)
        stack.callback(bus.subscribe("/clock", "rosgraph_msgs/Clock", _clock_of(bus)).close)
        for member in subscribe_monitor(monitor, bus):
            stack.callback(member.close)
        _interrupts.sleep(seconds)
        now = bus.clock.now()
        lines, faults = monitor.lines(now), monitor.faults(now)
    for line in lines:
        console.print(line, markup=False, soft_wrap=True)
    for fault in faults if monitor.frames else ["no transform came: does /tf have a publisher?"]:
        err(fault)
    return 1 if faults or not monitor.frames else 0


def _clock_of(bus: Any) -> Any:
    return lambda message: bus.clock.set(message.clock.to_sec())


def _joined(
    stack: ExitStack, loaded: Any, connect: str | None, ros1: bool, ros2: bool, domain: int | None
) -> Any:
    """Connect `armcell tf` to a source of /tf messages. Return the bus that receives the messages; the
    connection lasts until `stack` closes.

    The source is an endpoint, a ROS 1 graph, a ROS 2 domain, or the cell itself in mode fake.

    Raises:
        InputError: the connection failed, or the cell did not start.
    """
    from armcell.ros import Bus

    if connect is not None or ros1:
        from armcell.cli.topic import connected_bus
        from armcell.ros.tf_monitor import TOPICS

        wanted = {"/clock": "rosgraph_msgs/Clock", **dict.fromkeys(TOPICS, "tf2_msgs/TFMessage")}
        return stack.enter_context(connected_bus(connect or "", ros1=ros1, subscribe=wanted))[0]
    bus = Bus()
    if ros2:
        from armcell.cli.ros_options import join_ros2

        join_ros2(stack, bus, "armcell_tf", domain)()
        return bus
    from armcell.ros.nodes import CellNode

    node = CellNode(loaded.connect("fake", None, time_scale=1.0), bus)
    thread: threading.Thread = node.start()
    stack.callback(thread.join, 5.0)
    stack.callback(node.close)
    if not node.ready.wait(120):
        raise InputError("the cell did not start")
    return bus
