"""ROS 2 serialization (CDR) of the bus's messages, and message definitions for Cyclone DDS.

The definitions include messages derived from actions. The bus's own definitions, which are ROS 1's,
apply to user-defined types and to types that have the same layout in ROS 2.

The library validates samples with these types and announces them to other participants.
"""

from __future__ import annotations

import dataclasses
import struct
import threading
from collections.abc import Callable
from functools import cache
from typing import Any, cast

from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys.store import Typestore

from armcell.core import InputError, UnknownNameError
from armcell.ros.codec import MAX_ITEMS, WireError
from armcell.ros.definitions import PLACEHOLDER, Definition, field_parts, plain_name, rosbags_name
from armcell.ros.distros import DISTROS, distro_definitions
from armcell.ros.ros2.names import DdsName, dds_type
from armcell.ros.ros2.type_hash import TypeHashes
from armcell.ros.schema import ArrayConverter, Message, Schema, make_class, python_name

HEADER_BYTES = 4  # CDR's encapsulation header, before the fields

_MISSING: Any = object()


def definitions(schema: Schema, distro: str) -> dict[str, Definition]:
    """Return the message definitions that the ROS 2 codec of a distribution uses, by `pkg/Name`, including
    the messages of its actions.

    Raises:
        UnknownNameError: the distribution does not exist.
    """
    theirs = distro_definitions(distro).messages
    found = schema.definitions | {n: d for n, d in theirs.items() if n not in schema.own}
    for action in schema.actions:
        found |= _action_messages(action)
    return found


def _action_messages(action: str) -> dict[str, Definition]:
    """Return the messages of an action that the ROS 2 codec encodes, as ROS 2's rosidl derives them from the
    definition of the action.

    Source: design.ros2.org/articles/actions.html.
    """
    uuid = ("goal_id", _node("unique_identifier_msgs/UUID"))
    parts: dict[str, list[Any]] = {
        "_SendGoal_Request": [uuid, ("goal", _node(f"{action}Goal"))],
        "_SendGoal_Response": [
            ("accepted", (Nodetype.BASE, ("bool", 0))),
            ("stamp", _node("builtin_interfaces/Time")),
        ],
        "_GetResult_Request": [uuid],
        "_GetResult_Response": [
            ("status", (Nodetype.BASE, ("int8", 0))),
            ("result", _node(f"{action}Result")),
        ],
        "_FeedbackMessage": [uuid, ("feedback", _node(f"{action}Feedback"))],
    }
    return {f"{action}{part}": Definition([], fields) for part, fields in parts.items()}


def _node(name: str) -> Any:
    return (Nodetype.NAME, rosbags_name(name))


class Ros2Codec:
    """Thread-safe codec for the messages of one schema in one ROS 2 distribution. The encoding is
    little-endian CDR.

    Raises:
        UnknownNameError: the distribution does not exist.
    """

    name = "ros2"

    def __init__(self, schema: Schema, distro: str):
        self.schema, self.distro = schema, distro
        self.definitions = definitions(schema, distro)
        self.hashes = TypeHashes(self.definitions, schema.services, schema.actions)
        self._store = Typestore(max_sequence_length=MAX_ITEMS)
        for name, definition in self.definitions.items():
            self._store.fielddefs[rosbags_name(name)] = cast(Any, tuple(definition))
        self._store.types = _Makers(self)
        self._wire: dict[str, type[Message]] = {}
        self._tidies: dict[str, ArrayConverter] = {}
        self._translations: dict[str, _Translation] = {}

    # --- types ---
    def message(self, name: str) -> type[Message]:
        """Return the Python class of the messages that the ROS 2
        codec encodes and decodes for a message type.

        Raises:
            UnknownNameError: the type does not exist.
        """
        return self.schema.message(name) if name in self.schema.definitions else self.wire_class(name)

    def new(self, name: str, /, *values: Any, **fields: Any) -> Any:
        return self.message(name)(*values, **fields)

    def wire_class(self, name: str) -> type[Message]:
        """Return the class of the messages that the ROS 2 codec serializes.
        It has exactly the fields that ROS 2 defines.
        """
        if name not in self._wire:
            if name not in self.definitions:
                raise UnknownNameError("ROS 2 type", name, self.definitions)
            self._wire[name] = make_class(name, self.definitions[name], self.wire_class)
        return self._wire[name]

    def has_ros2_only_fields(self, name: str) -> bool:
        """Return whether the ROS 2 codec knows fields of a message type that ROS 1 does not have.

        Messages that a script creates lack those fields.
        """
        return name in self.schema.definitions and self.schema.merged_definition(
            name
        ) != self.schema.definition(name)

    def prepare(self, name: str) -> None:
        """Generate the serialization functions of the ROS 2 codec for a
        message type in advance, before their first use.

        Generation takes up to 0.1 s.
        """
        self._store.get_msgdef(rosbags_name(name))

    def type_hash(self, name: str, kind: str = "msg") -> str | None:
        """Return the type hash (REP 2016) of a ROS 2 message, service or action in the schema of the codec.

        Returns:
            The hash, or None for distributions without type hashes.
        """
        return self.hashes.of(name, kind) if DISTROS[self.distro].has_hashes else None

    # --- bytes ---
    def encode(self, message: Any) -> memoryview:
        """Encode a message as CDR bytes with the ROS 2 codec. The bytes begin with the encapsulation header.

        Raises:
            InputError: a field's value does not fit its type.
        """
        name = message._type
        try:
            tidy = self._tidy(name)
            message = tidy(message) if tidy.needed else message
            translate = self.translation(name)
            return self._store.serialize_cdr(translate(message), rosbags_name(name))
        except (struct.error, SerdeError, AttributeError, TypeError, ValueError, OverflowError) as error:
            raise InputError(f"{name} cannot be encoded: {error}") from None

    def decode(self, name: str, data: bytes | memoryview) -> Any:
        """Decode CDR bytes with the ROS 2 codec. They must contain exactly one message.

        Raises:
            WireError: the bytes are not a message of this type.
        """
        if len(data) == HEADER_BYTES and _is_empty(self, name):
            return self.new(name)
        try:
            return self._store.deserialize_cdr(data, rosbags_name(name))
        except SerdeError as error:
            raise WireError(f"{len(data)} bytes are no {name}: {error}") from None
        except (IndexError, OverflowError, MemoryError) as error:
            raise WireError(f"{len(data)} bytes are no {name}: {error!r}") from None

    def _tidy(self, name: str) -> ArrayConverter:
        if name in self.schema.definitions:
            return self.schema.array_converter(name)
        if name not in self._tidies:
            self._tidies[name] = ArrayConverter(self.definitions[name], self._tidy)
        return self._tidies[name]

    def translation(self, name: str) -> _Translation:
        """Return the function with which the codec converts a message of the bus to the field layout of ROS
        2.
        """
        if name not in self._translations:
            self._translations[name] = _Translation(self, name)
        return self._translations[name]


def _is_empty(codec: Ros2Codec, name: str) -> bool:
    return codec.definitions[name].fields[0][0] == PLACEHOLDER


def _pairs(codec: Ros2Codec, name: str) -> list[tuple[str, str | None]]:
    """Pair each field of a ROS 2 message with the field of the bus message from which the codec copies its
    value, or with None if the bus message has no such field.

    Names match regardless of case: CameraInfo's `d` in ROS 2 is `D` on the bus.
    """
    ours = codec.message(name)._fields
    lower = {field.lower(): field for field in ours}
    found = []
    for field, _ in codec.definitions[name].fields:
        if field != PLACEHOLDER:
            attribute = python_name(field)
            found.append((attribute, attribute if attribute in ours else lower.get(attribute.lower())))
    return found


class _Translation:
    """Function object of the ROS 2 codec that converts a message of armcell's bus to the field layout of the
    ROS 2 message.

    Messages whose fields match already are returned without a copy.
    """

    def __init__(self, codec: Ros2Codec, name: str):
        self._make: Callable[..., Any] = codec.wire_class(name)
        self._pairs: list[tuple[str, str | None, _Translation | None, bool]] = []
        nodes = [node for field, node in codec.definitions[name].fields if field != PLACEHOLDER]
        self.needed = codec.has_ros2_only_fields(name)
        for (field, ours), node in zip(_pairs(codec, name), nodes):
            is_message, kind, length = field_parts(node)
            inner = codec.translation(kind) if is_message else None
            inner = inner if inner is not None and inner.needed else None
            self._pairs.append((field, ours, inner, length is not None))
            self.needed = self.needed or field != ours or inner is not None

    def __call__(self, message: Any) -> Any:
        if not self.needed:
            return message
        values: dict[str, Any] = {}
        for field, ours, inner, several in self._pairs:
            if ours is None:
                continue
            value = getattr(message, ours, _MISSING)
            if value is _MISSING:
                continue
            if inner is not None:
                value = [inner(v) for v in value] if several else inner(value)
            values[field] = value
        return self._make(**values)


class _Makers(dict):
    """Constructors of messages for the ROS 2 codec, by the type names of rosbags.
    Each constructor is built on first use.

    The deserializer calls a constructor with the values that it has read.
    """

    def __init__(self, codec: Ros2Codec):
        super().__init__()
        self._codec = codec

    def __missing__(self, name: str) -> Any:
        self[name] = maker = _maker(self._codec, plain_name(name))
        return maker


def _maker(codec: Ros2Codec, name: str) -> Any:
    cls: Any = codec.message(name)
    if _is_empty(codec, name):
        return lambda _=0: cls()
    sources = [ours for _, ours in _pairs(codec, name)]
    if tuple(sources) == cls._fields:
        return cls
    take: list[tuple[int, Any]] = [
        (sources.index(field.name) if field.name in sources else -1, field.default_factory)
        for field in dataclasses.fields(cls)
    ]
    return lambda *values: cls(*(values[i] if i >= 0 else default() for i, default in take))


@cache
def ros2_codec(schema: Schema, distro: str) -> Ros2Codec:
    """Return the codec for a schema and a ROS 2 distribution. Codecs are cached."""
    return Ros2Codec(schema, distro)


class Types:
    """Thread-safe cache of the IDL types that `cyclonedds` needs for the messages of a ROS 2 codec. Each type
    is built on first use.
    """

    def __init__(self, codec: Ros2Codec):
        self._codec = codec
        self._lock = threading.Lock()
        self._structs: dict[str, Any] = {}
        self._topics: dict[tuple[str, str], Any] = {}

    def of(self, name: DdsName) -> Any:
        """Return the IDL type that `cyclonedds` needs for the ROS 2 codec's message of a topic.

        Raises:
            InputError: DDS has no type for one of the fields.
        """
        with self._lock:
            key = (name.type, name.message)
            if key not in self._topics:
                made = self._make(name.type, name.message, name.has_header)
                made.__idl__.populate()
                made.__idl__.fill_type_data()
                self._topics[key] = made
            return self._topics[key]

    def _make(self, type_name: str, message: str, has_header: bool) -> Any:
        from cyclonedds.idl import make_idl_struct, types

        # Source of the header: cdds_request_header_t of rmw_cyclonedds_cpp.
        fields: dict[str, Any] = {"guid": types.uint64, "seq": types.int64} if has_header else {}
        for field, node in self._codec.definitions[message].fields:
            fields[field] = self._field(node)
        return make_idl_struct(
            type_name.rpartition("::")[2], type_name.replace("::", "."), fields, dataclassify=False
        )

    def _struct(self, name: str) -> Any:
        if name not in self._structs:
            self._structs[name] = self._make(dds_type(self._codec.hashes.names.full(name)), name, False)
        return self._structs[name]

    def _field(self, node: Any) -> Any:
        from cyclonedds.idl import types

        kind, inner = node
        if kind == Nodetype.ARRAY:
            return types.array[self._field(inner[0]), inner[1]]
        if kind == Nodetype.SEQUENCE:
            item = self._field(inner[0])
            return types.sequence[item, inner[1]] if inner[1] else types.sequence[item]
        if kind == Nodetype.NAME:
            return self._struct(plain_name(inner))
        base, bound = inner
        if base == "string":
            return types.bounded_str[bound] if bound else str
        if base in ("byte", "octet", "char"):
            return types.uint8
        found = bool if base == "bool" else getattr(types, base, None)
        if found is None:
            raise InputError(f"{base} fields cannot be sent over DDS")
        return found
