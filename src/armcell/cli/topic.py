"""`armcell topic`: list, read and publish topics of a ROS-TCP endpoint; connection to a ROS 1 graph."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import typer
import yaml

from armcell import _interrupts
from armcell.cli.console import console, err
from armcell.cli.serve import address
from armcell.core import InputError, UnknownNameError

_SETTLE = 3.0  # [s] for subscribers to connect and to receive the messages
app = typer.Typer(help="Topics of a running endpoint: list, echo, hz, pub.", no_args_is_help=True)
CONNECT = typer.Option("127.0.0.1:10000", metavar="HOST:PORT", help="The ROS-TCP endpoint.")
ROS1 = typer.Option(False, "--ros1", help="In the ROS 1 graph at ROS_MASTER_URI instead.")
TYPE = typer.Option(None, "--type", metavar="TYPE", help="Where the endpoint does not know the topic.")
COUNT = typer.Option(None, "--count", "-n", min=1, help="End after so many messages.")
WAIT = 3.0  # [s] timeout to connect and to list the topics


class GraphClient:
    """Client of a ROS 1 graph for the commands `topic` and `service`. The class has the same methods as the
    client of a ROS-TCP connection.
    """

    def __init__(self, bus: Any, graph: Any):
        self._bus, self._graph = bus, graph

    def topic_list(self, timeout: float) -> dict[str, str]:
        """Return the topics of a ROS 1 graph for `armcell topic`, as a dict from topic to message type."""
        node = self._graph.node
        publishers, subscribers, _ = node.ask_master("getSystemState")
        others = {name for name, nodes in (*publishers, *subscribers) if set(nodes) - {node.name}}
        return {name: kind for name, kind in node.ask_master("getTopicTypes") if name in others}

    def wait_for_subscribers(self, topic: str) -> None:
        """Wait, for `armcell topic`, until all ROS 1 subscribers of a
        topic are connected, at most `_SETTLE` seconds.
        """
        node = self._graph.node
        self._graph.wait_settled(_SETTLE)
        subscribers = dict(node.ask_master("getSystemState")[1]).get(topic, [])
        count = len(set(subscribers) - {node.name})
        self._wait(lambda: sum(len(p.links()) for p in node.publications() if p.topic == topic) >= count)

    def flush(self) -> None:
        """Wait until `armcell topic pub` has sent all its messages to ROS 1, at most `_SETTLE` seconds."""
        node = self._graph.node
        self._wait(lambda: not any(x.waiting for p in node.publications() for x in p.links()))

    @staticmethod
    def _wait(what: Any) -> None:
        end = time.monotonic() + _SETTLE
        while not what() and time.monotonic() < end:
            _interrupts.sleep(0.01)


@contextmanager
def graph_connection() -> Iterator[tuple[Any, GraphClient]]:
    """Connect a new bus for `armcell topic` to the ROS 1 graph at ROS_MASTER_URI. Yield the bus and a client
    of the graph.

    Raises:
        InputError: no master answers.
    """
    from armcell.ros import Bus
    from armcell.ros.ros1 import Ros1Graph, from_environment

    bus = Bus()
    with Ros1Graph(bus, from_environment(f"armcell_topic_{os.getpid()}", own_master=False)) as graph:
        yield bus, GraphClient(bus, graph)


@app.command("list")
def list_topics(connect: str = CONNECT, ros1: bool = ROS1) -> None:
    """List the ROS topics with their message types."""
    with connected_bus(connect, ros1=ros1) as (_, client):
        for name, type_name in sorted(_topics(client).items()):
            console.print(f"{name}  {type_name}", soft_wrap=True, markup=False)


@app.command("echo")
def echo(
    topic: str, type_name: str | None = TYPE, connect: str = CONNECT, ros1: bool = ROS1,
    count: int | None = COUNT,
) -> None:  # fmt: skip
    """Print the messages of a ROS topic as YAML. Ctrl-C ends the command."""
    for n, message in enumerate(_messages(topic, type_name, connect, ros1, queue_size=100)):
        console.print(
            yaml.safe_dump(to_plain_data(message), sort_keys=False),
            "---",
            sep="",
            soft_wrap=True,
            markup=False,
        )
        if n + 1 == count:
            return


@app.command("hz")
def hz(
    topic: str, type_name: str | None = TYPE, connect: str = CONNECT, ros1: bool = ROS1,
    count: int | None = COUNT,
) -> None:  # fmt: skip
    """Print the rate of a ROS topic once per second. Ctrl-C ends the command."""
    arrivals: list[float] = []
    reported_at = time.monotonic()
    for n, _ in enumerate(_messages(topic, type_name, connect, ros1, queue_size=10_000)):
        arrivals = [*arrivals[-1000:], time.monotonic()]
        if len(arrivals) > 1 and (arrivals[-1] - reported_at >= 1.0 or n + 1 == count):
            reported_at = arrivals[-1]
            gaps = np.diff(arrivals)
            console.print(
                f"{1 / gaps.mean():.2f} Hz  gaps {gaps.min() * 1000:.1f} to {gaps.max() * 1000:.1f} ms  "
                f"({len(arrivals)} messages)"
            )
        if n + 1 == count:
            return


@app.command("pub")
def pub(
    topic: str,
    type_name: str = typer.Argument(..., metavar="TYPE", help="For instance std_msgs/Float64."),
    values: str = typer.Argument("{}", help="The fields as YAML: '{data: 0.04}'; what is left out is zero."),
    connect: str = CONNECT,
    ros1: bool = ROS1,
    rate: float | None = typer.Option(None, "--rate", "-r", min=0.01, help="Hz; once without."),
    count: int | None = COUNT,
) -> None:
    """Publish a message on a ROS topic, once or at a rate."""
    from armcell.ros import schema

    message = fill_message(schema().new(type_name), yaml_values(values))
    with connected_bus(connect, ros1=ros1, publish={topic: type_name}) as (bus, client):
        publisher = bus.advertise(topic, type_name)
        if ros1:
            client.wait_for_subscribers(publisher.topic)
        n = 0
        while True:
            publisher.publish(message)
            n += 1
            if n == (count or (None if rate else 1)):
                break
            _interrupts.sleep(1.0 / (rate or 1.0))
        client.flush() if ros1 else _flush(client)
        err(f"{n} published")


def to_plain_data(value: Any) -> Any:
    """Convert a message for `armcell topic echo` to dicts, lists and numbers, which the command prints."""
    if hasattr(value, "_fields"):
        return {name: to_plain_data(getattr(value, name)) for name in value._fields}
    if isinstance(value, np.ndarray):
        return value.tolist()
    return [to_plain_data(v) for v in value] if isinstance(value, list) else value


def fill_message(message: Any, values: Any) -> Any:
    """Fill the message of `armcell topic pub` with the values in a nested mapping, and return it.

    Raises:
        UnknownNameError: a field does not exist.
        InputError: the value for a nested message is not a mapping.
    """
    from armcell.ros import schema
    from armcell.ros.definitions import field_parts

    if not isinstance(values, dict):
        raise InputError(f"{values!r} is no set of fields of {message._type}", hint="{field: value, ...}")
    nodes = dict(schema().merged_definition(message._type).fields)
    for name, value in values.items():
        if name not in nodes:
            raise UnknownNameError(f"field of {message._type}", name, nodes)
        is_message, kind, length = field_parts(nodes[name])
        if is_message and length is None:
            value = fill_message(schema().new(kind), value)
        elif is_message:
            value = [fill_message(schema().new(kind), v) for v in value]
        setattr(message, name, value)
    return message


def yaml_values(text: str) -> Any:
    try:
        return yaml.safe_load(text) or {}
    except yaml.YAMLError as error:
        raise InputError(f"{text!r} is no YAML: {str(error).splitlines()[0]}") from None


@contextmanager
def connected_bus(
    connect: str, timeout: float = 10.0, ros1: bool = False, **bridge: dict[str, str]
) -> Iterator[tuple[Any, Any]]:
    """Connect a new bus for `armcell topic` to a ROS-TCP endpoint or a ROS 1 graph. Yield the bus and the
    client of the connection.

    Raises:
        InputError: no endpoint or master answers.
    """
    if ros1:
        with graph_connection() as joined:
            yield joined
        return
    from armcell.ros import Bus
    from armcell.ros.tcp import ForwardedNames, RosTcpClient

    host, port = address(connect)
    logging.getLogger("armcell.ros.tcp.client").setLevel(logging.ERROR)  # errors are reported below
    bus = Bus()
    with RosTcpClient(bus, host, port, ForwardedNames(**bridge), service_timeout=timeout) as client:
        if not client.wait_connected(WAIT):
            raise InputError(
                f"no ROS-TCP endpoint at {connect}", hint="start one: armcell serve CELL --unity; firewall?"
            )
        yield bus, client


def _topics(client: Any) -> dict[str, str]:
    found = client.topic_list(WAIT)
    if found is None:
        raise InputError("the endpoint sent no list of topics")
    return found


def _messages(topic: str, type_name: str | None, connect: str, ros1: bool, queue_size: int) -> Iterator[Any]:
    from armcell.ros.names import resolve

    topic = resolve(topic)
    if type_name is None:
        with connected_bus(connect, ros1=ros1) as (_, client):
            known = _topics(client)
        if topic not in known:
            raise UnknownNameError("topic", topic, known)
        type_name = known[topic]
    with connected_bus(connect, ros1=ros1, subscribe={topic: type_name}) as (bus, _):
        subscription = bus.subscribe(topic, type_name, queue_size=queue_size)
        while True:
            _interrupts.check()
            message = subscription.get(timeout=0.2)
            if message is not None:
                yield message


def _flush(client: Any) -> None:
    """Wait until the endpoint has received all messages that `armcell topic pub` has published.

    The endpoint answers in order, so a request that it answers proves that all earlier messages arrived.
    """
    client.topic_list(WAIT)
