"""ROS 2 bytes of the bus's messages, by the definitions of a distribution.

Messages stay the bus's own (ROS 1's fields). A field that only ROS 2 has is written with its default and
left out when read; one that only the bus has (a header's `seq`) the other way round. Types that only ROS 2
has (rcl_interfaces, action_msgs) get classes here.
"""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Callable
from functools import cache
from typing import Any, cast

from rosbags.serde import SerdeError
from rosbags.typesys.store import Typestore

from armcell.core import InputError, UnknownNameError
from armcell.ros.codec import MAX_ITEMS, WireError
from armcell.ros.definitions import PLACEHOLDER, field_parts, plain_name, rosbags_name
from armcell.ros.messages import Message, Tidy, make_class, python_name
from armcell.ros.ros2.dialect import DISTROS, definitions
from armcell.ros.schema import Schema

HEADER_BYTES = 4  # CDR's own, before the fields


class Ros2Codec:
    """One schema in one distribution's encoding (CDR, little-endian). Thread-safe.

    Raises:
        UnknownNameError: no such distribution.
    """

    name = "ros2"

    def __init__(self, schema: Schema, distro: str):
        self.schema, self.distro = schema, distro
        self.definitions = definitions(schema, distro)
        self._store = Typestore(max_sequence_length=MAX_ITEMS)
        for name, definition in self.definitions.items():
            self._store.fielddefs[rosbags_name(name)] = cast(Any, tuple(definition))
        self._store.types = _Makers(self)
        self._wire: dict[str, type[Message]] = {}
        self._tidies: dict[str, Tidy] = {}
        self._translations: dict[str, _Translation] = {}

    # --- types ---
    def knows(self, name: str) -> bool:
        return name in self.definitions

    def message(self, name: str) -> type[Message]:
        """The class a message of this type has on our side.

        Raises:
            UnknownNameError: no such type.
        """
        return self.schema.message(name) if name in self.schema.definitions else self.wire_class(name)

    def new(self, name: str, /, *values: Any, **fields: Any) -> Any:
        return self.message(name)(*values, **fields)

    def wire_class(self, name: str) -> type[Message]:
        """The class with exactly ROS 2's fields."""
        if name not in self._wire:
            if name not in self.definitions:
                raise UnknownNameError("ROS 2 type", name, self.definitions)
            self._wire[name] = make_class(name, self.definitions[name], self.wire_class)
        return self._wire[name]

    def prepare(self, name: str) -> None:
        """Make the functions of a type now (up to 0.1 s), not at its first message."""
        self._store.get_msgdef(rosbags_name(name))

    def type_hash(self, name: str) -> str | None:
        """REP 2016's hash of a message type; None in distributions that have none."""
        if not DISTROS[self.distro].has_hashes:
            return None
        return self._store.hash_rihs01(rosbags_name(name))

    # --- bytes ---
    def encode(self, message: Any) -> memoryview:
        """A message's bytes with CDR's four before them.

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
        """The message in `data`, which must be all of it.

        Raises:
            WireError: the bytes are not such a message.
        """
        if len(data) == HEADER_BYTES and _is_empty(self, name):
            return self.new(name)
        try:
            return self._store.deserialize_cdr(data, rosbags_name(name))
        except SerdeError as error:
            raise WireError(f"{len(data)} bytes are no {name}: {error}") from None
        except (IndexError, OverflowError, MemoryError) as error:
            raise WireError(f"{len(data)} bytes are no {name}: {error!r}") from None

    def _tidy(self, name: str) -> Tidy:
        if name in self.schema.definitions:
            return self.schema.tidy(name)
        if name not in self._tidies:
            self._tidies[name] = Tidy(self.definitions[name], self._tidy)
        return self._tidies[name]

    def translation(self, name: str) -> _Translation:
        """What turns a message of ours into one with ROS 2's fields."""
        if name not in self._translations:
            self._translations[name] = _Translation(self, name)
        return self._translations[name]


def _is_empty(codec: Ros2Codec, name: str) -> bool:
    return codec.definitions[name].fields[0][0] == PLACEHOLDER


def _pairs(codec: Ros2Codec, name: str) -> list[tuple[str, str | None]]:
    """ROS 2's fields, each with our attribute: None where we have none. CameraInfo's `d` is our `D`."""
    ours = codec.message(name)._fields
    lower = {field.lower(): field for field in ours}
    found = []
    for field, _ in codec.definitions[name].fields:
        if field != PLACEHOLDER:
            attribute = python_name(field)
            found.append((attribute, attribute if attribute in ours else lower.get(attribute.lower())))
    return found


class _Translation:
    """Ours to ROS 2's. Messages whose fields can be read as they are pass through, uncopied."""

    def __init__(self, codec: Ros2Codec, name: str):
        self._make: Callable[..., Any] = codec.wire_class(name)
        self._pairs: list[tuple[str, str | None, _Translation | None, bool]] = []
        self.needed = False
        nodes = [node for field, node in codec.definitions[name].fields if field != PLACEHOLDER]
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
            value = getattr(message, ours)
            if inner is not None:
                value = [inner(v) for v in value] if several else inner(value)
            values[field] = value
        return self._make(**values)


class _Makers(dict):
    """What makes a message of the values read, by rosbags' names; made when first asked for."""

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
    """The codec of a schema and a distribution, made once."""
    return Ros2Codec(schema, distro)
