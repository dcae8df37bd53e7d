"""Conversion of message definitions to `cyclonedds` types.

The library validates samples with these types and announces them to other participants.
"""

from __future__ import annotations

import threading
from typing import Any

from rosbags.interfaces import Nodetype

from armcell.core import InputError
from armcell.ros.definitions import plain_name
from armcell.ros.ros2.codec import Ros2Codec
from armcell.ros.ros2.names import DdsName, dds_type


class Types:
    """Thread-safe cache of the IDL types with which `cyclonedds` describes messages.
    Each type is built on first use.
    """

    def __init__(self, codec: Ros2Codec):
        self._codec = codec
        self._lock = threading.Lock()
        self._structs: dict[str, Any] = {}
        self._topics: dict[tuple[str, str], Any] = {}

    def of(self, name: DdsName) -> Any:
        """Return the IDL type with which `cyclonedds` describes the message of a topic.

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
