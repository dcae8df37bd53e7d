"""Options for all robot files of a command: xacro arguments and ROS package folders.

The command line passes them on in environment variables, because child processes of a command load the same
files.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from armcell.core import InputError

XACRO_ARGS, PACKAGES = "ARMCELL_XACRO_ARGS", "ARMCELL_PACKAGES"
"""Environment variables with JSON objects: xacro arguments, and package folders by name."""
_NAME = re.compile(r"[^\s:=]+")


def assignments(words: Iterable[str], separator: str, what: str) -> dict[str, str]:
    """Parse command-line options such as `dof:=7` into a mapping of xacro arguments.

    Args:
        separator: ":=" or "=".
        what: name of the option, for the error message.
    Raises:
        InputError: a word has no separator or no name before it.
    """
    found = {}
    for word in words:
        name, given, value = word.partition(separator)
        if not given or not _NAME.fullmatch(name):
            raise InputError(
                f"{what} {word!r} is not NAME{separator}VALUE", hint=f"{what} NAME{separator}VALUE"
            )
        found[name] = value
    return found


def set_xacro_args(words: Iterable[str]) -> None:
    """Set xacro arguments from command-line options `name:=value`. They apply to all robot files loaded by
    this process and its children.
    """
    _put(XACRO_ARGS, assignments(words, ":=", "--xacro-arg"))


def set_packages(words: Iterable[str]) -> None:
    """Set the folders of ROS packages, given as command-line options `name=folder`, for this process and its
    children.

    Raises:
        InputError: a folder does not exist.
    """
    folders = assignments(words, "=", "--package")
    for name, folder in folders.items():
        if not os.path.isdir(folder):
            raise InputError(
                f"--package {name}={folder}: no such folder", hint="give the package's own folder"
            )
        folders[name] = str(Path(folder).resolve())
    _put(PACKAGES, folders)


def xacro_args(own: Mapping[str, str] | None = None) -> dict[str, str]:
    """Combine the xacro arguments of a robot file with those from command-line options, which take
    precedence.
    """
    return {**(own or {}), **_read(XACRO_ARGS)}


def package_folder(name: str) -> Path | None:
    """Return the folder of a ROS package that the command-line option `--package` specifies, or None."""
    folder = _read(PACKAGES).get(name)
    return None if folder is None else Path(folder)


def _put(variable: str, values: Mapping[str, str]) -> None:
    if values:
        os.environ[variable] = json.dumps({**_read(variable), **values})


def _read(variable: str) -> dict[str, str]:
    text = os.environ.get(variable)
    if not text:
        return {}
    try:
        return {str(k): str(v) for k, v in json.loads(text).items()}
    except (ValueError, AttributeError):
        raise InputError(f"environment variable {variable} is not a JSON object", hint="unset it") from None
