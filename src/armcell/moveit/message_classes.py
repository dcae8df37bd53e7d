"""Message classes for scripts, with genpy's field types and its YAML text form.

Like genpy's classes they hold arrays as lists and uint8[] as bytes. Their fields and type names equal those
of the bus's own classes, so the same codecs encode and decode both. Scripts can read and set fields that only
ROS 2 has (an error code's `message`), but printing and comparison ignore these fields.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np

from armcell.moveit import allowed_collision_matrix
from armcell.moveit.ros_time import Duration, Time
from armcell.ros.definitions import PLACEHOLDER, field_parts
from armcell.ros.schema import Schema, python_name, schema

BYTES = ("uint8", "char")  # element types of arrays that genpy stores as bytes
STAMPS: dict[str, type] = {Time._type: Time, Duration._type: Duration}


class ScriptMessage:
    """Base class of the message classes that ROS scripts import."""

    __slots__ = ()
    _type: ClassVar[str]
    _fields: ClassVar[tuple[str, ...]]

    def __eq__(self, other: object) -> bool:
        if getattr(other, "_type", None) != self._type:
            return NotImplemented
        return all(_same(getattr(self, n), getattr(other, n)) for n in self._fields)

    __hash__ = None  # type: ignore[assignment]  # mutable

    def __str__(self) -> str:
        return text_of(self)

    __repr__ = __str__


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, list | tuple | np.ndarray) and isinstance(b, list | tuple | np.ndarray):
        return len(a) == len(b) and all(_same(x, y) for x, y in zip(a, b))
    return bool(a == b)


def text_of(value: Any, indent: str = "") -> str:
    """Return a message of a ROS script as YAML text, formatted as in ROS."""
    lines = []
    for name in value._fields:
        item = getattr(value, name)
        if name in ("sec", "nanosec"):
            name = {"sec": "secs", "nanosec": "nsecs"}[name]
        if hasattr(item, "_fields"):
            lines.append(f"{indent}{name}: \n{text_of(item, indent + '  ')}")
        elif isinstance(item, list | tuple) and len(item) and hasattr(item[0], "_fields"):
            lines.append(f"{indent}{name}: ")
            for one in item:
                lines.append(f"{indent}  - \n{text_of(one, indent + '    ')}")
        elif isinstance(item, str):
            lines.append(f'{indent}{name}: "{item}"')
        elif isinstance(item, np.ndarray | tuple):
            lines.append(f"{indent}{name}: {list(item)}")
        else:
            lines.append(f"{indent}{name}: {item}")
    return "\n".join(lines)


class MessageClasses:
    """Message classes for ROS scripts, built from a schema of message definitions. Each class is created on
    first use.
    """

    def __init__(self, of: Schema):
        self.schema = of
        self._classes: dict[str, type] = dict(STAMPS)

    def __getitem__(self, name: str) -> type:
        """Return the class of a message type `pkg/Name`.

        Raises:
            UnknownNameError: the type does not exist.
        """
        if name not in self._classes:
            self._classes[name] = self._make(name)
        return self._classes[name]

    def _make(self, name: str) -> type:
        definition = self.schema.merged_definition(name)
        specs: list[Any] = [
            (python_name(field), Any, dataclasses.field(default_factory=self._default(node)))
            for field, node in definition.fields
            if field != PLACEHOLDER
        ]
        namespace: dict[str, Any] = {constant: value for constant, _, value in definition.constants}
        namespace |= {
            "_type": name,
            "_fields": tuple(
                python_name(field) for field, _ in self.schema.definition(name).fields if field != PLACEHOLDER
            ),
            "_md5sum": self.schema.md5(name),
            "__module__": f"{name.split('/')[0]}.msg",
            PLACEHOLDER: 0,
        }
        if name == allowed_collision_matrix.MATRIX:
            namespace |= allowed_collision_matrix.METHODS
        return dataclasses.make_dataclass(
            name.split("/")[1], specs, bases=(ScriptMessage,), namespace=namespace,
            eq=False, repr=False, slots=True,
        )  # fmt: skip

    def _default(self, node: Any) -> Callable[[], Any]:
        is_message, kind, length = field_parts(node)
        if length is None:
            if is_message:
                return self[kind]
            return {"string": str, "bool": bool, "float32": float, "float64": float}.get(kind, int)
        if kind in BYTES:
            return functools.partial(bytes, length)
        if is_message:
            cls = self[kind]
            return lambda: [cls() for _ in range(length)]
        zero: Any = {"string": "", "bool": False, "float32": 0.0, "float64": 0.0}.get(kind, 0)
        return lambda: [zero] * length

    def local(self, message: Any) -> Any:
        """Return a copy of a bus message for a ROS script, which may modify the copy.
        Numeric arrays become tuples, as in genpy.
        """
        name = message._type
        if name in STAMPS:
            return STAMPS[name](message.sec, message.nanosec)
        copy = self[name]()
        for field, node in self.schema.merged_definition(name).fields:
            if field == PLACEHOLDER:
                continue
            attribute = python_name(field)
            value = getattr(message, attribute)
            is_message, kind, length = field_parts(node)
            if is_message:
                value = self.local(value) if length is None else [self.local(item) for item in value]
            elif length is not None:
                value = _local_array(kind, value)
            setattr(copy, attribute, value)
        return copy


def _local_array(kind: str, value: Any) -> Any:
    if kind in BYTES:
        return bytes(value) if isinstance(value, bytes | bytearray) else np.asarray(value, np.uint8).tobytes()
    values = value.tolist() if isinstance(value, np.ndarray) else value
    return list(values) if kind in ("string", "bool") else tuple(values)


@functools.cache
def classes() -> MessageClasses:
    """Return the message classes for ROS scripts, built from the built-in message definitions."""
    return MessageClasses(schema())
