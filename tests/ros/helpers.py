"""Random messages, and the other programs the tests talk to."""

from __future__ import annotations

import numpy as np

from armcell.cell import LiveCell
from armcell.ros.definitions import PLACEHOLDER, field_parts
from armcell.ros.nodes import RemoteDriver, RemoteMotions
from armcell.ros.schema import DTYPES, STAMPS, Schema, python_name
from armcell.tasks import TaskSettings

TEXTS = ("", "a", "joint_1", "żółw", "panda_link0", "x" * 17)


def remote_cell(bus, scene, controllers=()) -> RemoteMotions:
    """A running cell whose robot is at the other end of the bus; close it."""
    driver = RemoteDriver(bus, scene, controllers)
    cell = RemoteMotions(LiveCell("remote", scene, driver, TaskSettings(), (), 0), driver)
    cell.start()
    assert cell.ready.wait(120)
    return cell


def random_message(schema: Schema, name: str, rng: np.random.Generator, depth: int = 0):
    """A message with every field drawn: numbers over their whole range, short lists, any text."""
    if name in STAMPS:  # ROS 1's classes carry surplus nanoseconds over to the seconds
        return schema.new(name, int(rng.integers(2**31)), int(rng.integers(10**9)))
    message = schema.new(name)
    for field, node in schema.definition(name).fields:
        if field != PLACEHOLDER:
            setattr(message, python_name(field), _value(schema, node, rng, depth))
    return message


def _value(schema, node, rng, depth):
    is_message, kind, length = field_parts(node)
    if length is None:
        if is_message:
            return random_message(schema, kind, rng, depth + 1)
        if kind == "string":
            return TEXTS[rng.integers(len(TEXTS))]
        return _numbers(kind, 1, rng)[0].item()
    count = length or int(rng.integers(0, 4 if depth < 3 else 2))
    if is_message:
        return [random_message(schema, kind, rng, depth + 1) for _ in range(count)]
    if kind == "string":
        return [TEXTS[i] for i in rng.integers(len(TEXTS), size=count)]
    return _numbers(kind, count, rng)


def _numbers(kind, count, rng):
    dtype = np.dtype(DTYPES[kind])
    if dtype.kind == "f":
        return rng.normal(size=count).astype(dtype)
    if dtype.kind == "b":
        return rng.integers(0, 2, count).astype(dtype)
    limits = np.iinfo(dtype)
    return rng.integers(limits.min, limits.max, count, dtype=dtype, endpoint=True)
