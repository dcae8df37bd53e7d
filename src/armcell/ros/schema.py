"""The message schema: every type by name, its class, definition text and md5 sum.

One schema serves all wires. `schema()` is the built-in one; `Schema(...)` with a folder adds a user's types.
It is also the allow-list: a name from a wire is looked up here and never imported.
"""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from armcell.core import InputError, UnknownNameError
from armcell.ros.definitions import (
    FOLDER,
    PLACEHOLDER,
    Definition,
    field_parts,
    nested,
    noetic,
    plain_name,
    read_folder,
)
from armcell.ros.messages import Message, Tidy, make_class

ROS1_TIMES = {"builtin_interfaces/Time": "time", "builtin_interfaces/Duration": "duration"}
ACTION_PARTS = ("Goal", "Result", "Feedback")


class Schema:
    """Message types by name.

    Args:
        folders: definitions beside the built-in ones, each `<folder>/<package>/msg|srv|action/...`.
    Raises:
        InputError: a file is wrong, a type differs from one of the same name, a nested type is missing.
    """

    def __init__(self, *folders: Path):
        self.definitions: dict[str, Definition] = {}
        self.services: list[str] = []
        self.actions: list[str] = []
        for found in (noetic(), *(read_folder(folder) for folder in (FOLDER, *folders))):
            for name, definition in found.messages.items():
                if self.definitions.setdefault(name, definition) != definition:
                    raise InputError(f"message {name} is defined twice, differently")
            self.services = sorted({*self.services, *found.services})
            self.actions = sorted({*self.actions, *found.actions})
        for name, definition in self.definitions.items():
            for inner in nested(definition):
                if inner not in self.definitions:
                    raise InputError(f"{name} uses {inner}, which is not defined", cure="add its .msg file")
        self._classes: dict[str, type] = {}
        self._tidies: dict[str, Tidy] = {}
        self._texts: dict[str, str] = {}

    # --- types ---
    @property
    def messages(self) -> list[str]:
        """Every message, the parts of services and actions among them."""
        return sorted(self.definitions)

    def definition(self, name: str) -> Definition:
        try:
            return self.definitions[plain_name(name)]
        except KeyError:
            raise UnknownNameError("message type", name, self.definitions) from None

    def message(self, name: str) -> type[Any]:
        """The class of `pkg/Name` (also `pkg/msg/Name`): a `Message` with the definition's fields.

        Raises:
            UnknownNameError: no such type.
        """
        name = plain_name(name)
        if name not in self._classes:  # of two threads that make it at once, all get the first one's
            self._classes.setdefault(name, make_class(name, self.definition(name), self.message))
        return self._classes[name]

    def new(self, name: str, /, *values: Any, **fields: Any) -> Any:
        """A message: `new("geometry_msgs/Point", x=1.0)`, `new("builtin_interfaces/Time", 3, 500)`."""
        return self.message(name)(*values, **fields)

    def service(self, name: str) -> tuple[type[Message], type[Message]]:
        """Request and response class of a service.

        Raises:
            UnknownNameError: no such service.
        """
        name = plain_name(name)
        if name not in self.services:
            raise UnknownNameError("service type", name, self.services)
        return self.message(f"{name}Request"), self.message(f"{name}Response")

    def action(self, name: str) -> str:
        """An action's name without the suffix `Action`: `moveit_msgs/MoveGroup`.

        Raises:
            UnknownNameError: no such action.
        """
        plain = plain_name(name).removesuffix("Action")
        if plain not in self.actions:
            raise UnknownNameError("action type", name, self.actions)
        return plain

    def tidy(self, name: str) -> Tidy:
        """What makes a message of this type fit for the wire."""
        if name not in self._tidies:
            self._tidies.setdefault(name, Tidy(self.definition(name), self.tidy))
        return self._tidies[name]

    # --- texts and sums ---
    def text(self, name: str) -> str:
        """A message's definition, one constant or field per line."""
        return "".join(f"{line}\n" for line in self._lines(self.definition(name), {}))

    def full_text(self, name: str) -> str:
        """The definition followed by those of all nested types, as TCPROS and bags carry it."""
        name = plain_name(name)
        seen: list[str] = [name]
        for outer in seen:  # grows while walked
            seen += [n for n in nested(self.definition(outer)) if n not in seen and n not in ROS1_TIMES]
        rest = (f"{'=' * 80}\nMSG: {inner}\n{self.text(inner)}" for inner in seen[1:])
        return self.text(name) + "".join(rest)

    def md5(self, name: str) -> str:
        """The sum ROS 1 compares, of a message or a service.

        Source: gentools.compute_md5 of ROS 1's genmsg: constants first, nested types by their own sums,
        comments and package names left out; a service's is the sum of request and response texts.
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
            sums = {inner: _md5(self._md5_text(inner)) for inner in nested(definition)}
            self._texts[name] = "\n".join(self._lines(definition, sums))
        return self._texts[name]

    def _lines(self, definition: Definition, names: Mapping[str, str]) -> list[str]:
        """Lines of a definition, nested types called by `names` where it has them (arrays then unmarked)."""
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


def _md5(text: str) -> str:
    return hashlib.md5(text.encode(), usedforsecurity=False).hexdigest()


_first = threading.Lock()  # `cache` would let two threads make one each


def schema() -> Schema:
    """The built-in schema."""
    with _first:
        return _built_in()


@cache
def _built_in() -> Schema:
    return Schema()
