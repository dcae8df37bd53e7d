"""The message schema: message classes, layouts of the ROS 2 distributions, definition texts, MD5 sums.

A numeric array is a numpy array with the element type of the definition. A list, as ROS scripts often assign,
is also valid; the encoder converts it to an array.

One schema serves all transports: a type has ROS 1's layout if it exists in ROS 1, and its class also has the
fields that exist only in ROS 2. `schema()` returns the built-in schema; `Schema(folder)` adds a user's types.
The schema also acts as the allow-list: type names received from a network are looked up here and never
imported.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import keyword
import threading
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from armcell.core import InputError, UnknownNameError
from armcell.ros.definitions import (
    FOLDER,
    PLACEHOLDER,
    Definition,
    Interfaces,
    field_parts,
    nested_types,
    noetic_definitions,
    plain_name,
    read_folder,
)
from armcell.ros.distros import DISTROS, PLUMBING, distro_definitions

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
    """Base class of the ROS message classes that a schema creates. The attribute `_type` contains the name of
    the type, `pkg/Name`; constants are class attributes.
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
    """Base class of the schema's time and duration messages, which converts between their fields
    and seconds.
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
        """Create a message of the schema's time or duration class from seconds, rounded to the nearest
        nanosecond.

        `nanosec` is in the range 0 to 999999999.
        """
        sec, nanosec = divmod(round(seconds * 1e9), 1_000_000_000)
        return cls(sec, nanosec)  # type: ignore[call-arg]

    secs = property(lambda self: self.sec, lambda self, value: setattr(self, "sec", value))
    nsecs = property(lambda self: self.nanosec, lambda self, value: setattr(self, "nanosec", value))


STAMPS = ("builtin_interfaces/Time", "builtin_interfaces/Duration")


def python_name(field: str) -> str:
    """Return the attribute name that the message classes of a schema use for a field. If the field is named
    like a Python keyword, an underscore is appended: `lambda_`.
    """
    return f"{field}_" if keyword.iskeyword(field) else field


def make_class(name: str, definition: Definition, find: Callable[[str], type]) -> type:
    """Create the Python class with which a schema represents the ROS message `pkg/Name`, from the definition
    of the message.

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
    """Converter that the message schema provides for one message class: it turns the lists in a message into
    arrays of the types that the schema defines.

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
    """Return whether the array in a message field can be converted to the numeric type that the message
    schema defines, without changing any value.
    """
    if dtype.kind == "f":
        return array.dtype.kind in "fiub"
    if dtype.kind == "b":
        return array.dtype.kind in "bui"
    if array.dtype.kind not in "bui":
        return False
    limits = np.iinfo(dtype)
    return bool(array.min() >= limits.min and array.max() <= limits.max)


ROS1_TIMES = {"builtin_interfaces/Time": "time", "builtin_interfaces/Duration": "duration"}

ACTION_PARTS = ("Goal", "Result", "Feedback")


class Schema:
    """Registry of ROS message, service and action types by name.

    Args:
        folders: additional definitions, each `<folder>/<package>/msg|srv|action/...`.
    Raises:
        InputError: a file is invalid, a type is defined twice with different contents, or a nested type is
            missing.
    """

    def __init__(self, *folders: Path):
        self.definitions: dict[str, Definition] = {}
        self.services: list[str] = []
        self.actions: list[str] = []
        for found in (noetic_definitions(), read_folder(FOLDER)):
            self._add(found)
        built_in = set(self.definitions)
        for folder in folders:
            self._add(read_folder(folder))
        self.own = frozenset(self.definitions.keys() - built_in)  # types from the user's folders
        self._whole: dict[str, Definition] = {}
        ros1 = set(self.definitions)
        self._add_ros2()
        self.ros2_only = frozenset(self.definitions.keys() - ros1)
        for name in self.definitions:
            for inner in nested_types(self.merged_definition(name)):
                if inner not in self.definitions:
                    raise InputError(f"{name} uses {inner}, which is not defined", hint="add its .msg file")
        self._classes: dict[str, type] = {}
        self._tidies: dict[str, ArrayConverter] = {}
        self._texts: dict[str, str] = {}

    def _add(self, found: Interfaces) -> None:
        for name, definition in found.messages.items():
            if self.definitions.setdefault(name, definition) != definition:
                raise InputError(f"message {name} is defined twice, differently")
        self.services = sorted({*self.services, *found.services})
        self.actions = sorted({*self.actions, *found.actions})

    def _add_ros2(self) -> None:
        """Add to the message schema the types and fields that exist only in ROS 2.
        Newer distributions take precedence.
        """
        for distro in reversed(DISTROS):
            found = distro_definitions(distro)
            for name, definition in found.messages.items():
                if name.split("/")[0] in PLUMBING or name in self.own:
                    continue
                known = self.merged_definition(name) if name in self.definitions else None
                if known is None:
                    self.definitions[name] = definition
                elif (merged := _merged(known, definition)) != known:
                    self._whole[name] = merged
            self.services = sorted({*self.services, *found.services})
            self.actions = sorted({*self.actions, *found.actions})

    # --- types ---
    @property
    def messages(self) -> list[str]:
        """Return the sorted names of all messages in the schema,
        including the messages that services and actions consist of.
        """
        return sorted(self.definitions)

    def definition(self, name: str) -> Definition:
        try:
            return self.definitions[plain_name(name)]
        except KeyError:
            raise UnknownNameError("message type", name, self.definitions) from None

    def merged_definition(self, name: str) -> Definition:
        """Return the definition of a message type in the schema: its ROS 1 fields,
        followed by the fields that only ROS 2 has.

        The class of the type has all of these fields.

        Raises:
            UnknownNameError: the type does not exist.
        """
        return self._whole.get(plain_name(name)) or self.definition(name)

    def message(self, name: str) -> type[Any]:
        """Return the class for the message type `pkg/Name` (or `pkg/msg/Name`) in the schema.

        The class derives from `Message` and has the fields that `whole` returns.

        Raises:
            UnknownNameError: the type does not exist.
        """
        name = plain_name(name)
        if name not in self._classes:  # if two threads create the class, both use the first result
            self._classes.setdefault(name, make_class(name, self.merged_definition(name), self.message))
        return self._classes[name]

    def new(self, name: str, /, *values: Any, **fields: Any) -> Any:
        """Create a message from the name of its type in the schema and from field values.

        Examples: `new("geometry_msgs/Point", x=1.0)`, `new("builtin_interfaces/Time", 3, 500)`.
        """
        return self.message(name)(*values, **fields)

    def service(self, name: str) -> tuple[type[Message], type[Message]]:
        """Return the message classes for the request and the response of a service type in the schema.

        Raises:
            UnknownNameError: the service type does not exist.
        """
        name = plain_name(name)
        if name not in self.services:
            raise UnknownNameError("service type", name, self.services)
        return self.message(f"{name}Request"), self.message(f"{name}Response")

    def action(self, name: str) -> str:
        """Return the name of an action type in the schema, in the form `pkg/Name` without the suffix
        `Action`.

        Raises:
            UnknownNameError: the action type does not exist.
        """
        plain = plain_name(name).removesuffix("Action")
        if plain not in self.actions:
            raise UnknownNameError("action type", name, self.actions)
        return plain

    def array_converter(self, name: str) -> ArrayConverter:
        """Return the converter with which the schema prepares messages of one type for encoding."""
        if name not in self._tidies:
            self._tidies.setdefault(name, ArrayConverter(self.merged_definition(name), self.array_converter))
        return self._tidies[name]

    # --- texts and sums ---
    def text(self, name: str) -> str:
        """Return the definition of a message type in the schema as text, with one constant or field per
        line.
        """
        return "".join(f"{line}\n" for line in self._lines(self.definition(name), {}))

    def full_text(self, name: str) -> str:
        """Return the definition of a message type in the schema as text, followed by those of all nested
        types. Bag files use this form.
        """
        name = plain_name(name)
        seen: list[str] = [name]
        for outer in seen:  # the loop appends nested types to this list
            seen += [n for n in nested_types(self.definition(outer)) if n not in seen and n not in ROS1_TIMES]
        rest = (f"{'=' * 80}\nMSG: {inner}\n{self.text(inner)}" for inner in seen[1:])
        return self.text(name) + "".join(rest)

    def md5(self, name: str) -> str:
        """Return the MD5 sum of a message or service type in the schema. ROS 1 programs compare it when they
        connect.

        Source: `gentools.compute_md5` in ROS 1's genmsg. The text lists constants first, replaces each nested
        type by its MD5 sum, and omits comments and package names. The text of a service is the request text
        followed by the response text.
        """
        name = plain_name(name)
        if name in self.services:
            text = self._md5_text(f"{name}Request") + self._md5_text(f"{name}Response")
        else:
            text = self._md5_text(name)
        return _md5(text)

    def _md5_text(self, name: str) -> str:
        if name not in self._texts:
            definition = self.definition(name)
            sums = {inner: _md5(self._md5_text(inner)) for inner in nested_types(definition)}
            self._texts[name] = "\n".join(self._lines(definition, sums))
        return self._texts[name]

    def _lines(self, definition: Definition, names: Mapping[str, str]) -> list[str]:
        """Return the lines of a message definition in the schema. Types of nested messages are replaced
        according to the dict `names`.

        A replaced type has no array suffix.
        """
        lines = [f"{kind} {constant}={value}" for constant, kind, value in definition.constants]
        for field, node in definition.fields:
            if field == PLACEHOLDER:
                continue
            is_message, kind, length = field_parts(node)
            is_time = kind in ROS1_TIMES
            array = "" if length is None else f"[{length or ''}]"
            if is_message and not is_time and kind in names:
                lines.append(f"{names[kind]} {field}")
            else:
                lines.append(f"{ROS1_TIMES.get(kind, kind)}{array} {field}")
        return lines


def _merged(known: Definition, other: Definition) -> Definition:
    """Merge two definitions of a message in the schema: the first definition,
    followed by the fields that only the second one has.

    Field names are compared without case, because CameraInfo's names differ only in case.
    """
    constants = {name for name, _, _ in known.constants}
    fields = {name.lower() for name, _ in known.fields} | {PLACEHOLDER}
    return Definition(
        known.constants + [c for c in other.constants if c[0] not in constants],
        known.fields + [f for f in other.fields if f[0].lower() not in fields],
    )


def _md5(text: str) -> str:
    return hashlib.md5(text.encode(), usedforsecurity=False).hexdigest()


_first = threading.Lock()  # `cache` alone would let two threads each create a schema


def schema() -> Schema:
    """Return the built-in message schema. All callers share one instance."""
    with _first:
        return _built_in()


@cache
def _built_in() -> Schema:
    return Schema()
