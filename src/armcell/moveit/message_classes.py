"""Message classes as genpy makes them: lists where it has lists, bytes for uint8[], printed as YAML.

They carry the same fields under the same type names as the bus's own, which encode and read them alike.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np

from armcell.moveit import matrix
from armcell.moveit.ros_time import Duration, Time
from armcell.ros.definitions import PLACEHOLDER, field_parts
from armcell.ros.messages import python_name
from armcell.ros.schema import Schema, schema

BYTES = ("uint8", "char")  # genpy keeps these arrays as bytes
STAMPS: dict[str, type] = {Time._type: Time, Duration._type: Duration}


class ScriptMessage:
    """Base of the classes that scripts see."""

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
    """A message as YAML, in the form that printing one in ROS has."""
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
    """The classes of one schema, made when they are first asked for."""

    def __init__(self, of: Schema):
        self.schema = of
        self._classes: dict[str, type] = dict(STAMPS)

    def __getitem__(self, name: str) -> type:
        """The class of `pkg/Name`.

        Raises:
            UnknownNameError: no such type.
        """
        if name not in self._classes:
            self._classes[name] = self._make(name)
        return self._classes[name]

    def _make(self, name: str) -> type:
        definition = self.schema.definition(name)
        specs: list[Any] = [
            (python_name(field), Any, dataclasses.field(default_factory=self._default(node)))
            for field, node in definition.fields
            if field != PLACEHOLDER
        ]
        namespace: dict[str, Any] = {constant: value for constant, _, value in definition.constants}
        namespace |= {
            "_type": name,
            "_fields": tuple(spec[0] for spec in specs),
            "_md5sum": self.schema.md5(name),
            "__module__": f"{name.split('/')[0]}.msg",
            PLACEHOLDER: 0,
        }
        if name == matrix.MATRIX:
            namespace |= matrix.METHODS
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
        """A script's own copy of a message from the bus: arrays of numbers are tuples then, as with genpy."""
        name = message._type
        if name in STAMPS:
            return STAMPS[name](message.sec, message.nanosec)
        copy = self[name]()
        for field, node in self.schema.definition(name).fields:
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
    """Those of the built-in schema."""
    return MessageClasses(schema())
