"""Our CDR against Cyclone DDS's, the one ROS 2 systems speak: the same bytes for every type.

Cyclone's Python classes are made from our schema, so what is compared is the encoding: order, alignment,
lengths, strings, nesting.
"""

from dataclasses import make_dataclass
from functools import cache

import numpy as np
import pytest
from tests.ros.helpers import random_message

from armcell.ros.codec import cdr_codec
from armcell.ros.definitions import PLACEHOLDER, field_parts
from armcell.ros.schema import python_name, schema

idl = pytest.importorskip(
    "cyclonedds.idl", reason="cyclonedds is not installed (pip install 'armcell[ros2]')"
)
types = pytest.importorskip("cyclonedds.idl.types")

BASE = {
    "bool": bool, "string": str, "byte": types.int8, "char": types.uint8, "float32": types.float32,
    "float64": types.float64, **{f"{s}int{b}": getattr(types, f"{s}int{b}")
                                 for s in ("", "u") for b in (8, 16, 32, 64)},
}  # fmt: skip


def fields(name):
    found = [(python_name(f), n) for f, n in schema().definition(name).fields]
    return [f for f in found if not (name == "std_msgs/Header" and f[0] == "seq")]


@cache
def struct(name):
    members = []
    for field, node in fields(name):
        is_message, kind, length = field_parts(node)
        element = struct(kind) if is_message else BASE[kind]
        if length is not None:
            element = types.array[element, length] if length else types.sequence[element]
        members.append((field, element))
    return make_dataclass(name.replace("/", "_"), members, bases=(idl.IdlStruct,))


def translated(message):
    name = message._type
    values = {PLACEHOLDER: 0} if not message._fields else {}
    for field, _ in fields(name):
        if field != PLACEHOLDER:
            value = getattr(message, field)
            if isinstance(value, np.ndarray):
                value = value.tolist()
            elif isinstance(value, list):
                value = [translated(v) if hasattr(v, "_fields") else v for v in value]
            elif hasattr(value, "_fields"):
                value = translated(value)
            values[field] = value
    return struct(name)(**values)


@pytest.mark.slow
def test_every_type_has_cyclones_bytes():
    rng = np.random.default_rng(8)
    for name in schema().messages:
        for message in [schema().new(name), *(random_message(schema(), name, rng) for _ in range(2))]:
            theirs = translated(message).serialize(use_version_2=False)
            ours = bytes(cdr_codec().encode(message))
            assert ours[4:] == theirs[4 : len(ours)], name
            assert len(theirs) - len(ours) < 4, name  # Cyclone pads the end to four bytes
