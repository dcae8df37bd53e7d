"""Safe readers for untrusted text, XML and YAML files.

The readers limit file sizes, expand no XML entities, use no network, and report each error in one line.
"""

from __future__ import annotations

import logging
import math
import os
import re
from pathlib import Path
from typing import Any, BinaryIO

import yaml
from lxml import etree

from armcell.core import InputError

logger = logging.getLogger(__name__)

MAX_TEXT_BYTES = 20_000_000
MAX_YAML_BYTES = 2_000_000
MAX_YAML_DEPTH = 64
MAX_YAML_ALIASES = 50  # allows ordinary anchors, stops a "billion laughs" document


MAX_KEY_DIGITS = 18  # longest integer key: an attacker can choose larger keys with equal hashes


class SafeLoader(yaml.CSafeLoader):
    """YAML loader for plain data from untrusted files. It rejects integer keys with more than 18 digits.

    An attacker can choose large integer keys with equal hashes, which makes a dictionary slow to build.
    """

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        for key, _ in node.value:
            if key.tag == "tag:yaml.org,2002:int" and len(key.value) > MAX_KEY_DIGITS:
                text = f"an integer key has more than {MAX_KEY_DIGITS} digits"
                raise yaml.MarkedYAMLError(problem=text, problem_mark=key.start_mark)
        return super().construct_mapping(node, deep)


class _Loader(SafeLoader):
    """YAML loader for untrusted files. It reads booleans as in YAML 1.2 and rejects duplicate keys.

    Only `true` and `false` (also capitalized) are booleans, so a key named `on` stays a string. Plain YAML
    loaders keep the last of two equal keys without a warning.
    """

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        seen = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and key.tag != "tag:yaml.org,2002:merge":
                if key.value in seen:
                    self.repeated(key)
                seen.add(key.value)
        return super().construct_mapping(node, deep)

    def repeated(self, key: yaml.ScalarNode) -> None:
        text = f"key {key.value!r} is given twice"
        raise yaml.MarkedYAMLError(problem=text, problem_mark=key.start_mark)


_Loader.yaml_implicit_resolvers = {
    first: [(tag, regexp) for tag, regexp in rules if tag != "tag:yaml.org,2002:bool"]
    for first, rules in yaml.CSafeLoader.yaml_implicit_resolvers.items()
}
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:bool", re.compile(r"^(?:true|True|TRUE|false|False|FALSE)$"), list("tTfF")
)


def read_text(path: Path, limit: int = MAX_TEXT_BYTES) -> str:
    """Return the text of a UTF-8 file, read safely even if the file is untrusted.

    Raises:
        InputError: the file is missing, a folder, larger than `limit` bytes or not UTF-8.
    """
    try:
        if os.path.isdir(path):
            raise InputError("is a folder, a file is needed", file=path)
        size = path.stat().st_size
        if not os.path.isfile(path):
            raise InputError("is no regular file", file=path)
        if size > limit:
            raise InputError(f"is larger than {limit} bytes", file=path)
        return path.read_text(encoding="utf-8")
    except (FileNotFoundError, NotADirectoryError):
        raise InputError("file not found", file=path, hint="check the path") from None
    except PermissionError:
        raise InputError("no permission to read", file=path) from None
    except OSError as error:  # for example, a file name that is too long
        raise InputError(f"cannot be read: {error.strerror}", file=path) from None
    except UnicodeDecodeError as error:
        raise InputError(f"is not UTF-8 text ({error.reason} at byte {error.start})", file=path) from None
    except ValueError:  # the name contains a NUL character
        raise InputError(f"{str(path)!r} is not a file name", hint="check the path") from None


class BoundedReader:
    """Wrapper around an untrusted binary file that never tries to read more bytes than the file has left.

    A corrupt file can declare a length of gigabytes, and the ordinary `read` allocates that much memory
    before it reads.
    """

    def __init__(self, stream: BinaryIO):
        self._stream, self._size = stream, os.fstat(stream.fileno()).st_size

    def read(self, size: int = -1) -> bytes:
        left = max(self._size - self._stream.tell(), 0)
        return self._stream.read(left if size < 0 else min(size, left))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def parse_xml(text: str, file: Path | str) -> etree._Element:
    """Parse XML text safely even if it is untrusted, and return its root element.

    `docinfo.URL` of the element's tree contains the file name.

    Raises:
        InputError: the XML is not well-formed (with the line), or declares a DOCTYPE (a DOCTYPE can define
            entities that expand without limit).
    """
    parser = etree.XMLParser(
        resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False, remove_comments=True
    )
    try:
        root = etree.fromstring(text.encode(errors="replace"), parser, base_url=str(file))
    except etree.XMLSyntaxError as error:
        if "<!DOCTYPE" not in text:
            raise InputError(f"is not valid XML: {error.msg}", file=file, line=error.lineno) from None
        root = None
    if root is None or root.getroottree().docinfo.doctype:
        reason = "declares a DOCTYPE or entity, which armcell refuses"
        raise InputError(reason, file=file, hint="delete the DOCTYPE")
    return root


def check_yaml_events(text: str, path: Path) -> None:
    """Reject YAML text that is expensive to load because it has deep nesting or many aliases.

    Raises:
        InputError: more than 50 aliases ("billion laughs" attack), or more than 64 nesting levels.
    """
    aliases = depth = 0
    for event in yaml.parse(text, _Loader):
        if isinstance(event, yaml.AliasEvent):
            aliases += 1
        elif isinstance(event, yaml.CollectionStartEvent):
            depth += 1
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1
        if aliases > MAX_YAML_ALIASES:
            raise InputError(f"uses more than {MAX_YAML_ALIASES} YAML aliases", file=path)
        if depth > MAX_YAML_DEPTH:
            raise InputError(f"is nested deeper than {MAX_YAML_DEPTH} levels", file=path)


def yaml_value(text: str) -> Any:
    """Parse one YAML value from a string safely, by the same rules as for YAML files.

    Raises:
        yaml.YAMLError: `text` is not valid YAML.
    """
    return yaml.load(text, _Loader)


class _RosLoader(_Loader):
    """YAML loader for the files of ROS packages. As in rosparam, the last value of a repeated key counts, and
    the tags `!degrees` and `!radians` are supported.
    """

    path: Path | None = None

    def repeated(self, key: yaml.ScalarNode) -> None:
        line = key.start_mark.line + 1
        logger.warning("%s:%s: key %r is given twice, the last one counts", self.path, line, key.value)


def _angle(factor: float) -> Any:
    return lambda loader, node: factor * float(loader.construct_scalar(node))


_RosLoader.add_constructor("!degrees", _angle(math.pi / 180))
_RosLoader.add_constructor("!radians", _angle(1.0))


def read_yaml(path: Path, ros: bool = False) -> dict[str, Any]:
    """Read a YAML file safely. Its top level must be a mapping.

    Args:
        ros: whether the file belongs to a ROS package, where a key may be given twice (with a warning) and
            `!degrees` marks an angle.
    Raises:
        InputError: the file is missing, not YAML (with the line), not a mapping, or uses too many aliases.
    """
    text = read_text(path, MAX_YAML_BYTES)
    try:
        check_yaml_events(text, path)
        data = yaml.load(text, type("Loader", (_RosLoader,), {"path": path}) if ros else _Loader)
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else None
        raise InputError(f"is not valid YAML: {error.problem}", file=path, line=line) from None
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        first = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"is not valid YAML: {first}", file=path) from None
    if not isinstance(data, dict):
        raise InputError(f"top level is {type(data).__name__}, a mapping is needed", file=path)
    return data
