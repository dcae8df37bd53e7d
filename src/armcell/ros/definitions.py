"""Parser for `.msg`, `.srv` and `.action` texts.

A definition is a list of constants and a list of fields in rosbags' form. Type names have the form
`pkg/Name`; rosbags' form `pkg/msg/Name` is used only inside the package `ros`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.base import TypesysError

from armcell.core import InputError

FOLDER = Path(__file__).parent / "definitions"
NOETIC_PACKAGES = (
    "actionlib",
    "actionlib_msgs",
    "builtin_interfaces",
    "diagnostic_msgs",
    "geometry_msgs",
    "nav_msgs",
    "rosgraph_msgs",
    "sensor_msgs",
    "shape_msgs",
    "std_msgs",
    "stereo_msgs",
    "trajectory_msgs",
    "visualization_msgs",
)
"""Packages whose definitions come from rosbags' Noetic set."""

PLACEHOLDER = "structure_needs_at_least_one_member"  # field of an empty message in rosbags and ROS 2
MAX_FILE_BYTES = 1_000_000
_NAME = re.compile(r"^[A-Za-z][A-Za-z0-9_]*$")

Field = tuple[str, Any]  # field name and type node of rosbags


class Definition(NamedTuple):
    """Definition of one ROS message, parsed from its text: the constants (name, base type, value) and the
    fields.
    """

    constants: list[tuple[str, str, Any]]
    fields: list[Field]


class Interfaces(NamedTuple):
    """Parsed ROS definitions: messages by name, and the names of services and actions."""

    messages: dict[str, Definition]
    services: list[str]
    actions: list[str]


def plain_name(name: str) -> str:
    """Return the name under which the definition of a ROS type is stored: `pkg/Name` for `pkg/msg/Name`,
    `pkg/srv/Name` and `pkg/action/Name`.
    """
    parts = name.split("/")
    return f"{parts[0]}/{parts[2]}" if len(parts) == 3 and parts[1] in ("msg", "srv", "action") else name


def rosbags_name(name: str) -> str:
    """Return the name under which rosbags stores a ROS message definition: `pkg/msg/Name` for `pkg/Name`."""
    package, _, item = name.partition("/")
    return f"{package}/msg/{item}"


def field_parts(node: Any) -> tuple[bool, str, int | None]:
    """Split the type of a field in a parsed `.msg` definition into its parts.

    Returns:
        Tuple (is a message, base type or `pkg/Name`, array length). The length is None for a field that is
            not an array, and 0 for an array of variable length.
    """
    length: int | None = None
    kind, inner = node
    if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        (kind, inner), size = inner
        length = size if node[0] == Nodetype.ARRAY else 0
    if kind == Nodetype.NAME:
        return True, plain_name(inner), length
    return False, inner[0], length


def noetic_definitions() -> Interfaces:
    """Return the message definitions of the common packages in ROS Noetic, as rosbags contains them."""
    store = get_typestore(Stores.ROS1_NOETIC)
    messages = {
        plain_name(name): Definition(list(constants), list(fields))
        for name, (constants, fields) in store.fielddefs.items()
        if name.split("/")[0] in NOETIC_PACKAGES
    }
    actions = [n.removesuffix("ActionGoal") for n in messages if n.endswith("ActionGoal")]
    return Interfaces(messages, [], actions)


def read_folder(folder: Path) -> Interfaces:
    """Read all ROS message, service and action definitions from a folder with the layout
    `<package>/msg/<Name>.msg`.

    Raises:
        InputError: a file is invalid, or the folder contains no definitions; the error names the file and the
            reason.
    """
    messages: dict[str, Definition] = {}
    services: list[str] = []
    actions: list[str] = []
    found = False
    for file in sorted(folder.rglob("*")):
        if file.suffix not in (".msg", ".srv", ".action") or file.parent.name != file.suffix[1:]:
            continue
        found = True
        name = f"{file.parent.parent.name}/{file.stem}"
        if not (_NAME.match(file.stem) and _NAME.match(file.parent.parent.name)):
            raise InputError(f"{name!r} is no message name", file=file, hint="use letters, digits and _")
        if file.stat().st_size > MAX_FILE_BYTES:
            raise InputError(f"is larger than {MAX_FILE_BYTES} bytes", file=file)
        text = file.read_text(encoding="utf-8")
        try:
            if file.suffix == ".msg":
                messages.update(parse(text, name))
            elif file.suffix == ".srv":
                messages.update(parse_service(text, name))
                services.append(name)
            else:
                messages.update(parse_action(text, name))
                actions.append(name)
        except InputError as error:
            raise InputError(error.reason, file=file, hint=error.hint) from None
    if not found:
        raise InputError(
            "has no message definitions",
            file=folder,
            hint="expected <package>/msg/<Name>.msg (or srv/<Name>.srv, action/<Name>.action)",
        )
    return Interfaces(messages, services, actions)


def parse(text: str, name: str) -> dict[str, Definition]:
    """Parse the text of a `.msg` file into the definition of a ROS message.

    Args:
        text: contents of the file.
        name: name of the message, `pkg/Name`.
    Raises:
        InputError: the text is not a valid message definition.
    """
    try:
        constants, fields = get_types_from_msg(text, rosbags_name(name))[rosbags_name(name)]
    except (TypesysError, KeyError, ValueError) as error:
        raise InputError(f"{name} is not a message definition: {error}") from None
    return {name: Definition(list(constants), list(fields) or [(PLACEHOLDER, (Nodetype.BASE, ("uint8", 0)))])}


def parse_service(text: str, name: str) -> dict[str, Definition]:
    """Parse the text of a `.srv` file into the ROS messages `NameRequest` and `NameResponse`."""
    request, response = _sections(text, name, 2)
    return parse(request, f"{name}Request") | parse(response, f"{name}Response")


def parse_action(text: str, name: str) -> dict[str, Definition]:
    """Parse the text of an `.action` file into the seven messages that ROS 1's actionlib uses for an
    action.
    """
    goal, result, feedback = _sections(text, name, 3)
    texts = {
        "Goal": goal,
        "Result": result,
        "Feedback": feedback,
        "ActionGoal": f"Header header\nactionlib_msgs/GoalID goal_id\n{name}Goal goal",
        "ActionResult": f"Header header\nactionlib_msgs/GoalStatus status\n{name}Result result",
        "ActionFeedback": f"Header header\nactionlib_msgs/GoalStatus status\n{name}Feedback feedback",
        "Action": "\n".join(
            f"{name}Action{part} action_{part.lower()}" for part in ("Goal", "Result", "Feedback")
        ),
    }
    found: dict[str, Definition] = {}
    for suffix, section in texts.items():
        found |= parse(section, name + suffix)
    return found


def _sections(text: str, name: str, count: int) -> list[str]:
    sections = re.split(r"(?m)^---[ \t]*$", text)
    if len(sections) != count:
        raise InputError(f"{name} has {len(sections)} sections, need {count} with '---' between them")
    return sections


def nested_types(definition: Definition) -> Iterator[str]:
    """Yield the names of the message types that occur directly in the fields of a ROS message definition."""
    for _, node in definition.fields:
        is_message, name, _ = field_parts(node)
        if is_message:
            yield name
