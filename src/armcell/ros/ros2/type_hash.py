"""RIHS01 type hashes, with which ROS 2 nodes since Iron compare type definitions.

Source: REP 2016; rosidl_generator_type_description for the hashed text, rosidl_parser for the types that ROS
2 derives from a service or an action. `tests/ros/ros2/rihs_jazzy.txt` contains hashes from ROS 2's own
builds.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from typing import Any

from rosbags.interfaces import Nodetype

from armcell.ros.definitions import Definition, plain_name

# type_description_interfaces/FieldType; rosidl reads `char` as uint8.
TYPE_IDS = {
    "int8": 2, "uint8": 3, "int16": 4, "uint16": 5, "int32": 6, "uint32": 7, "int64": 8, "uint64": 9,
    "float32": 10, "float64": 11, "float128": 12, "char": 3, "wchar": 14, "bool": 15, "byte": 16, "octet": 16,
    "string": 17, "wstring": 18,
}  # fmt: skip
NESTED, BOUNDED_STRING, BOUNDED_WSTRING = 1, 21, 22
ARRAY, BOUNDED_SEQUENCE, SEQUENCE = 48, 96, 144  # added to the type id of the items
ACTION_PARTS = (
    "Goal", "Result", "Feedback", "_SendGoal_Request", "_SendGoal_Response", "_GetResult_Request",
    "_GetResult_Response", "_FeedbackMessage",
)  # fmt: skip
ACTION_SERVICES = ("_SendGoal", "_GetResult")


class TypeNames:
    """Full type names for computing the type hashes of ROS 2:
    `pkg/msg/Name`, `pkg/srv/Name_Request`, `pkg/action/Name_Goal`.
    """

    def __init__(self, services: Iterable[str], actions: Iterable[str]):
        self._parts: dict[str, str] = {}
        for service in services:
            for part in ("Request", "Response"):
                self._parts[service + part] = f"{_full(service, 'srv')}_{part}"
        for action in actions:
            for part in ACTION_PARTS:
                self._parts[action + part] = f"{_full(action, 'action')}_{part.removeprefix('_')}"

    def full(self, name: str) -> str:
        """Return the full ROS 2 type name for a type hash, such as `pkg/msg/Name`. `name` is a message type
        `pkg/Name` or a part of a service or action.
        """
        return self._parts.get(name) or _full(name, "msg")


class TypeHashes:
    """Type hashes (RIHS01) of all message, service and action types in one ROS 2 distribution.

    Args:
        definitions: definition of every message by its `pkg/Name`, including parts of services and actions.
    """

    def __init__(
        self, definitions: Mapping[str, Definition], services: Iterable[str], actions: Iterable[str]
    ):
        self.names = TypeNames(services, actions)
        self._definitions = definitions
        self._hashes: dict[tuple[str, str], str] = {}

    def of(self, name: str, kind: str = "msg") -> str:
        """Return the type hash of a ROS 2 message, service or action: `RIHS01_` followed by 64 hexadecimal
        digits.

        Args:
            kind: "msg" (also for a part of a service or action), "srv" or "action"; needed because an action
                may have the same name as a message.
        Raises:
            KeyError: the type is unknown.
        """
        if (name, kind) not in self._hashes:
            self._hashes[name, kind] = self._hash(name, kind)
        return self._hashes[name, kind]

    def _hash(self, name: str, kind: str) -> str:
        described: dict[str, list[dict[str, Any]]] = {}
        if kind == "action":
            top = self._describe_action(name, described)
        elif kind == "srv":
            top = self._describe_service(_full(name, "srv"), f"{name}Request", f"{name}Response", described)
        else:
            top = self._describe(name, described)
        types = {full: {"type_name": full, "fields": fields} for full, fields in described.items()}
        text = json.dumps(
            {
                "type_description": types.pop(top),
                "referenced_type_descriptions": [types[full] for full in sorted(types)],
            }
        )
        return f"RIHS01_{hashlib.sha256(text.encode()).hexdigest()}"

    def _describe(self, name: str, described: dict[str, list[dict[str, Any]]]) -> str:
        """Add the descriptions of a message and its nested messages to the input of a type hash.
        Return the full name of the message.
        """
        full = self.names.full(name)
        if full not in described:
            described[full] = []  # a type cannot contain itself, so the order does not matter
            described[full] += [
                self._field(field, node, described) for field, node in self._definitions[name].fields
            ]
        return full

    def _describe_service(
        self, full: str, request: str, response: str, described: dict[str, list[dict[str, Any]]]
    ) -> str:
        """Add the descriptions of a service, its messages and its event message to the input of a type
        hash.
        """
        parts = {
            "request": self._describe(request, described),
            "response": self._describe(response, described),
        }
        info = self._describe("service_msgs/ServiceEventInfo", described)
        described[f"{full}_Event"] = [
            _named("info", NESTED, info),
            *(_named(part, BOUNDED_SEQUENCE + NESTED, nested, 1) for part, nested in parts.items()),
        ]
        described[full] = [
            _named("request_message", NESTED, parts["request"]),
            _named("response_message", NESTED, parts["response"]),
            _named("event_message", NESTED, f"{full}_Event"),
        ]
        return full

    def _describe_action(self, name: str, described: dict[str, list[dict[str, Any]]]) -> str:
        full = _full(name, "action")
        members = {part.lower(): self._describe(name + part, described) for part in ACTION_PARTS[:3]}
        for part, member in zip(ACTION_SERVICES, ("send_goal_service", "get_result_service")):
            members[member] = self._describe_service(
                full + part, f"{name}{part}_Request", f"{name}{part}_Response", described
            )
        members["feedback_message"] = self._describe(f"{name}_FeedbackMessage", described)
        described[full] = [_named(member, NESTED, nested) for member, nested in members.items()]
        return full

    def _field(self, field: str, node: Any, described: dict[str, list[dict[str, Any]]]) -> dict[str, Any]:
        shift, capacity, (kind, inner) = 0, 0, node
        if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            item, capacity = inner
            shift = ARRAY if kind == Nodetype.ARRAY else BOUNDED_SEQUENCE if capacity else SEQUENCE
            kind, inner = item
        if kind == Nodetype.NAME:
            return _named(field, shift + NESTED, self._describe(plain_name(inner), described), capacity)
        base, bound = inner
        number = TYPE_IDS[base]
        if bound and base in ("string", "wstring"):
            number = BOUNDED_STRING if base == "string" else BOUNDED_WSTRING
        return _named(field, shift + number, "", capacity, bound or 0)


def _named(name: str, number: int, nested: str = "", capacity: int = 0, bound: int = 0) -> dict[str, Any]:
    kind = {"type_id": number, "capacity": capacity, "string_capacity": bound, "nested_type_name": nested}
    return {"name": name, "type": kind}


def _full(name: str, kind: str) -> str:
    package, _, item = name.partition("/")
    return f"{package}/{kind}/{item}"
