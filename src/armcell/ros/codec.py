"""Message encoding and decoding in ROS 1 serialization and in CDR (ROS 2), based on rosbags.

Both encodings use the same schema, with one exception: in CDR, `std_msgs/Header` has no `seq`, as in ROS 2
and in Unity's connector.

Decoded arrays are read-only views of the received bytes, without a copy.
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
"""Maximum number of items in a sequence; no frame within the transports' size limits holds more."""


class WireError(ArmcellError):
    """Error of a ROS message codec: the given bytes are not a message of the expected type."""


class Codec:
    """Thread-safe codec for the ROS messages of one schema. It encodes and decodes bytes in ROS 1 or CDR
    format.

    Args:
        name: "ros1" for ROS 1 serialization, "cdr" for CDR.
        schema: the message types.
    """

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
        """Encode a ROS message as bytes in the format of this codec: ROS 1 serialization or CDR.

        Raises:
            InputError: the value of a field does not fit its type.
        """
        name = message._type
        tidy = self.schema.array_converter(name)
        message = tidy(message) if tidy.needed else message
        run = self._store.serialize_cdr if self._cdr else self._store.serialize_ros1
        try:
            return run(message, rosbags_name(name))
        except (struct.error, SerdeError, AttributeError, TypeError, ValueError, OverflowError) as error:
            raise InputError(f"{name} cannot be encoded: {error}", hint=_culprit(message)) from None

    def prepare(self, name: str) -> None:
        """Generate the codec functions for a message type in advance,
        so that its first message is not delayed.

        Generation takes up to 0.1 s, for example for a planning scene.

        Raises:
            UnknownNameError: the type does not exist.
        """
        self.schema.definition(name)
        self._store.get_msgdef(rosbags_name(plain_name(name)))

    def decode(self, name: str, data: bytes | memoryview) -> Any:
        """Decode bytes that contain exactly one ROS message of the type `name`, in the format of this codec.

        Raises:
            UnknownNameError: the type does not exist.
            WireError: the bytes are not a valid message of this type.
        """
        name = plain_name(name)
        if self._cdr and len(data) == 4 and _is_empty(self.schema.definition(name)):
            return self.schema.new(name)  # Unity omits the byte that ROS 2 puts into an empty message
        self.schema.definition(name)
        run = self._store.deserialize_cdr if self._cdr else self._store.deserialize_ros1
        try:
            return run(data, rosbags_name(name))
        except SerdeError as error:
            raise WireError(f"{len(data)} bytes are no {name} in {self.name}: {error}") from None
        except (IndexError, OverflowError, MemoryError) as error:
            raise WireError(f"{len(data)} bytes are no {name} in {self.name}: {error!r}") from None


class _Classes(dict):
    """Dictionary of the message classes that the codec uses, by their rosbags names.
    Each class is created on first access.
    """

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
    """Return a hint about the first field that the codec cannot encode,
    because it contains text instead of a number or vice versa.

    Returns None if no direct field of the message has this fault, that is, if the fault is nested deeper.
    """
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


def ros1_codec(schema: Schema | None = None) -> Codec:
    """Return the codec that reads and writes ROS 1 serialization for a schema, by default the built-in
    schema.
    """
    return _codec("ros1", schema or built_in())


def cdr_codec(schema: Schema | None = None) -> Codec:
    """Return the codec that reads and writes little-endian CDR with a 4-byte header for a schema, by default
    the built-in schema.

    CDR is the encoding of ROS 2.

    Args:
        schema: the message types; default: the built-in schema.
    """
    return _codec("cdr", schema or built_in())


CODECS = {"ROS1": ros1_codec, "ROS2": cdr_codec}
"""Codec factories by the protocol name in the handshake of ROS-TCP."""
