"""Message classes built from definitions: plain attributes, each field with a default value.

A numeric array is a numpy array with the element type of the definition. A list, as ROS scripts often assign,
is also valid; the encoder converts it to an array.
"""

from __future__ import annotations

import dataclasses
import functools
import keyword
from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np

from armcell.core import InputError
from armcell.ros.definitions import PLACEHOLDER, Definition, field_parts

DTYPES: dict[str, Any] = {
    "bool": np.bool_,
    "byte": np.int8,  # ROS 1: an alias of int8
    "char": np.uint8,
    "octet": np.uint8,
    **{
        f"{sign}int{bits}": np.dtype(f"{sign}int{bits}").type
        for sign in ("", "u")
        for bits in (8, 16, 32, 64)
    },
    "float32": np.float32,
    "float64": np.float64,
}
"""numpy element type of each base type in an encoded array."""


class Message:
    """Base class of all ROS message classes. The attribute `_type` contains the name of the type, `pkg/Name`;
    constants are class attributes.
    """

    __slots__ = ()
    _type: ClassVar[str]
    _fields: ClassVar[tuple[str, ...]]

    def __eq__(self, other: object) -> bool:
        if type(self) is not type(other):
            return NotImplemented
        return all(_equal(getattr(self, n), getattr(other, n)) for n in self._fields)

    __hash__ = None  # type: ignore[assignment]  # mutable


def _equal(a: Any, b: Any) -> bool:
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        return bool(np.array_equal(a, b))
    return a == b


class TimeMessage:
    """Base class of the ROS messages for times and durations, which converts between their fields and
    seconds.
    """

    __slots__ = ()
    sec: int
    nanosec: int

    def to_sec(self) -> float:
        return self.sec + self.nanosec * 1e-9

    def to_nsec(self) -> int:
        return self.sec * 1_000_000_000 + self.nanosec

    @classmethod
    def from_sec(cls, seconds: float) -> Any:
        """Create a ROS time or duration message from seconds, rounded to the nearest nanosecond.

        `nanosec` is in the range 0 to 999999999.
        """
        sec, nanosec = divmod(round(seconds * 1e9), 1_000_000_000)
        return cls(sec, nanosec)  # type: ignore[call-arg]

    secs = property(lambda self: self.sec, lambda self, value: setattr(self, "sec", value))
    nsecs = property(lambda self: self.nanosec, lambda self, value: setattr(self, "nanosec", value))


STAMPS = ("builtin_interfaces/Time", "builtin_interfaces/Duration")


def python_name(field: str) -> str:
    """Return the Python attribute name for a field of a ROS message. If the field is named like a Python
    keyword, an underscore is appended: `lambda_`.
    """
    return f"{field}_" if keyword.iskeyword(field) else field


def make_class(name: str, definition: Definition, find: Callable[[str], type]) -> type:
    """Create the Python class of the ROS message `pkg/Name` from its definition.

    Args:
        name: message name, `pkg/Name`.
        definition: constants and fields of the message.
        find: returns the class of another message by its name, for nested fields.
    """
    package, _, item = name.partition("/")
    specs: list[Any] = []
    for field, node in definition.fields:
        if field != PLACEHOLDER:
            specs.append((python_name(field), Any, dataclasses.field(default_factory=_default(node, find))))
    namespace: dict[str, Any] = {constant: value for constant, _, value in definition.constants}
    namespace |= {
        "_type": name,
        "_fields": tuple(spec[0] for spec in specs),
        "__doc__": f"{name}: {', '.join(spec[0] for spec in specs)}",
        "__module__": f"{package}.msg",
        PLACEHOLDER: 0,  # the CDR encoder reads this attribute if the message has no fields
    }
    bases = (TimeMessage, Message) if name in STAMPS else (Message,)
    return dataclasses.make_dataclass(item, specs, bases=bases, namespace=namespace, eq=False, slots=True)


def _default(node: Any, find: Callable[[str], type]) -> Callable[[], Any]:
    is_message, kind, length = field_parts(node)
    if is_message:
        cls = find(kind)
        return cls if length is None else functools.partial(_several, cls, length)
    if kind in ("string", "wstring"):
        return str if length is None else functools.partial(_several, str, length)
    if length is not None:
        return functools.partial(np.zeros, length, DTYPES[kind])
    return {"bool": bool, "float32": float, "float64": float}.get(kind, int)


def _several(make: Callable[[], Any], count: int) -> list[Any]:
    return [make() for _ in range(count)]


class ArrayConverter:
    """Converter that turns the lists in a ROS message into arrays of the type that the encoder needs.

    The original message does not change, and valid fields are not copied.
    """

    def __init__(self, definition: Definition, find: Callable[[str], ArrayConverter]):
        self._arrays: list[tuple[str, Any]] = []
        self._nested: list[tuple[str, bool, ArrayConverter]] = []
        for field, node in definition.fields:
            is_message, kind, length = field_parts(node)
            if is_message:
                inner = find(kind)
                if inner.needed:
                    self._nested.append((python_name(field), length is not None, inner))
            elif length is not None and kind not in ("string", "wstring"):
                self._arrays.append((python_name(field), np.dtype(DTYPES[kind])))
        self.needed = bool(self._arrays or self._nested)

    def __call__(self, message: Any) -> Any:
        changed: dict[str, Any] = {}
        for name, dtype in self._arrays:
            value = getattr(message, name)
            if not (
                type(value) is np.ndarray
                and value.dtype == dtype
                and value.ndim == 1
                and value.flags.c_contiguous
            ):
                changed[name] = _array(message, name, value, dtype)
        for name, several, inner in self._nested:
            value = getattr(message, name)
            if several:
                items = [inner(item) for item in value]
                if any(new is not old for new, old in zip(items, value)):
                    changed[name] = items
            elif (new := inner(value)) is not value:
                changed[name] = new
        return dataclasses.replace(message, **changed) if changed else message


def _array(message: Any, name: str, value: Any, dtype: np.dtype) -> Any:
    if isinstance(value, (bytes, bytearray, memoryview)):
        return np.frombuffer(value, dtype)
    try:
        array = np.asarray(value)
        if array.dtype != dtype and array.size and not _fits(array, dtype):
            raise ValueError(f"{array.dtype} values do not fit {dtype}")
        return np.ascontiguousarray(array, dtype).reshape(-1)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{message._type}.{name}: {error}") from None


def _fits(array: Any, dtype: np.dtype) -> bool:
    """Return whether the array in a message field can be converted to a numeric type without changing any
    value.
    """
    if dtype.kind == "f":
        return array.dtype.kind in "fiub"
    if dtype.kind == "b":
        return array.dtype.kind in "bui"
    if array.dtype.kind not in "bui":
        return False
    limits = np.iinfo(dtype)
    return bool(array.min() >= limits.min and array.max() <= limits.max)
