"""Encoding and decoding: ROS 1 serialisation and CDR (ROS 2), by rosbags' generated code.

Both speak the same schema. The ROS 2 dialect differs in one type: `std_msgs/Header` has no `seq`, as in
the messages of Unity's connector and in ROS 2's own.

Decoded arrays are views of the received bytes: nothing is copied, and they cannot be written to.
"""

from __future__ import annotations

import struct
from functools import cache
from typing import Any, cast

from rosbags.serde import SerdeError
from rosbags.typesys.store import Typestore

from armcell.core import ArmcellError, InputError
from armcell.ros.definitions import PLACEHOLDER, Definition, plain_name, rosbags_name
from armcell.ros.schema import Schema
from armcell.ros.schema import schema as built_in

HEADER = "std_msgs/Header"
MAX_ITEMS = 1 << 26
"""Items of one sequence: no frame within the wires' caps holds more."""


class WireError(ArmcellError):
    """Bytes that are no message of the type they are said to be."""


class Codec:
    """One encoding of one schema. Thread-safe: rosbags' functions keep no state."""

    def __init__(self, name: str, schema: Schema):
        self.name, self.schema = name, schema
        self._store = Typestore(max_sequence_length=MAX_ITEMS)
        self._cdr = name == "cdr"
        for message, definition in schema.definitions.items():
            fields = definition.fields
            if message == HEADER and self._cdr:
                fields = [field for field in fields if field[0] != "seq"]
            self._store.fielddefs[rosbags_name(message)] = cast(Any, (definition.constants, fields))
        self._store.types = _Classes(schema, self._cdr)

    def encode(self, message: Any) -> memoryview:
        """A message's bytes.

        Raises:
            InputError: a field's value does not fit its type.
        """
        name = message._type
        tidy = self.schema.tidy(name)
        message = tidy(message) if tidy.needed else message
        run = self._store.serialize_cdr if self._cdr else self._store.serialize_ros1
        try:
            return run(message, rosbags_name(name))
        except (struct.error, SerdeError, AttributeError, TypeError, ValueError, OverflowError) as error:
            raise InputError(f"{name} cannot be encoded: {error}", cure=_culprit(message)) from None

    def prepare(self, name: str) -> None:
        """Make the functions of a type now (up to 0.1 s for a planning scene), not at its first message.

        Raises:
            UnknownNameError: no such type.
        """
        self.schema.definition(name)
        self._store.get_msgdef(rosbags_name(plain_name(name)))

    def decode(self, name: str, data: bytes | memoryview) -> Any:
        """The message in `data`, which must be all of it.

        Raises:
            UnknownNameError: no such type.
            WireError: the bytes are not such a message.
        """
        name = plain_name(name)
        if self._cdr and len(data) == 4 and _is_empty(self.schema.definition(name)):
            return self.schema.new(name)  # Unity leaves out the byte that ROS 2 puts into an empty message
        self.schema.definition(name)
        run = self._store.deserialize_cdr if self._cdr else self._store.deserialize_ros1
        try:
            return run(data, rosbags_name(name))
        except SerdeError as error:
            raise WireError(f"{len(data)} bytes are no {name} in {self.name}: {error}") from None
        except (IndexError, OverflowError, MemoryError) as error:
            raise WireError(f"{len(data)} bytes are no {name} in {self.name}: {error!r}") from None


class _Classes(dict):
    """Classes by rosbags' names, made when first asked for."""

    def __init__(self, schema: Schema, cdr: bool):
        super().__init__()
        self._schema, self._cdr = schema, cdr

    def __missing__(self, name: str) -> Any:
        plain = plain_name(name)
        cls: Any = self._schema.message(plain)
        if plain == HEADER and self._cdr:
            make = cls
            cls = lambda stamp, frame_id: make(0, stamp, frame_id)  # noqa: E731
        elif self._cdr and _is_empty(self._schema.definitions[plain]):
            make = cls
            cls = lambda _=0: make()  # noqa: E731
        self[name] = cls
        return cls


def _is_empty(definition: Definition) -> bool:
    return definition.fields[0][0] == PLACEHOLDER


def _culprit(message: Any) -> str | None:
    """Which plain field has a value of the wrong kind; None if it lies deeper."""
    default = type(message)()
    for name in message._fields:
        value, model = getattr(message, name), getattr(default, name)
        wrong = not isinstance(value, str) if isinstance(model, str) else isinstance(value, str)
        if wrong:
            return f"{name} is {value!r}, it should be like {model!r}"
    return None


@cache
def _codec(name: str, schema: Schema) -> Codec:
    return Codec(name, schema)


def ros1(schema: Schema | None = None) -> Codec:
    """ROS 1 serialisation, of the built-in schema unless told."""
    return _codec("ros1", schema or built_in())


def cdr(schema: Schema | None = None) -> Codec:
    """CDR, little-endian, with its 4-byte header: ROS 2's encoding."""
    return _codec("cdr", schema or built_in())


CODECS = {"ROS1": ros1, "ROS2": cdr}
"""By the name of the protocol in ROS-TCP's handshake."""
