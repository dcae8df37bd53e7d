"""File access of robot descriptions, restricted to the robot's own packages.

Without the restriction, a description from another person could copy any YAML or XML file of the user into
the robot model, and a record, a served model or a written cell would disclose its content.
"""

from __future__ import annotations

import datetime
import fnmatch
import os
from pathlib import Path
from typing import Any

import yaml
from lxml import etree

from armcell.core import InputError
from armcell.model.assets import find_package, package_above, search_folders
from armcell.model.untrusted_files import (
    MAX_TEXT_BYTES,
    MAX_YAML_BYTES,
    SafeLoader,
    check_yaml_events,
    parse_xml,
    read_text,
)
from armcell.model.xacro.budget import Budget, XacroError, size
from armcell.model.xacro.expressions import AttributeDict

YAML_CHARACTERS = 4  # characters that count as one operation: the YAML parser is slow
XML_CHARACTERS = 40
UNITS = {
    "!radians": 1.0, "!degrees": 0.017453292519943295, "!meters": 1.0, "!millimeters": 0.001, "!foot": 0.3048,
    "!inches": 0.0254,
}  # fmt: skip


SHOWN = 20  # entries of a folder in an error message


class MissingFile(XacroError):
    """Error for a missing file that the xacro file of a robot includes or loads."""

    def depends_on(self, value: str) -> bool:
        """Return whether the value of a xacro argument can be the reason why the path of a required file is
        wrong.
        """
        return value in self.reason if value else "is a folder" in self.reason


class RobotFiles:
    """Reader for the files to which a xacro robot description refers. It reads only from allowed folders.

    Args:
        main: the robot file.
        budget: remaining operations of the robot file.
        home: folder that contains the robot's other files, if known; otherwise the package of `main`, or its
            folder.
    """

    def __init__(self, main: Path, budget: Budget, home: Path | None = None):
        self.main, self.budget = main.resolve(), budget
        above = package_above(self.main) or self.main.parent
        named = [home] if home is not None else []
        self.roots = [folder.resolve() for folder in (above, *named, *search_folders())]
        self._yaml: dict[Path, Any] = {}

    def find(self, package: str) -> Path:
        """Return the folder of a ROS package and allow xacro to read files from it.

        Raises:
            XacroError: the package does not exist.
        """
        try:
            found = find_package(package, self.main.parent)
        except InputError as error:
            raise XacroError(error.reason, error.hint) from None
        self.roots += [root for root in found.roots if root not in self.roots]
        return found.folder

    def checked(self, path: Path) -> Path:
        """Resolve symlinks in the path of a file that a xacro robot description reads, and check that the
        file is in one of the robot's packages.

        Raises:
            XacroError: the file is outside the robot's packages, or `path` is not a valid path.
        """
        if not str(path).isprintable():  # an error message would send control characters to the terminal
            raise XacroError(f"{str(path)!r} is not a path")
        try:
            real = path.resolve()
        except (OSError, RuntimeError, ValueError):
            raise XacroError(f"{path} is not a path") from None
        if not any(real.is_relative_to(root) for root in self.roots):
            link = "" if real == path.absolute() else f" (it leads to {real})"
            own = ", ".join(str(root) for root in self.roots[:3])
            raise XacroError(
                f"{path}{link} is outside the robot's packages ({own})",
                "copy the file into the robot's package, or name the package's parent folder in "
                "ROS_PACKAGE_PATH",
            )
        return real

    def existing(self, path: Path) -> Path:
        """Return the resolved path of an existing file in the packages of the robot.

        See `checked`.

        Raises:
            MissingFile: the file does not exist or is a folder; the hint lists what the nearest existing
                folder contains.
            XacroError: see `checked`.
        """
        path = self.checked(path)
        is_folder = os.path.isdir(path)
        if os.path.exists(path) and not is_folder:
            return path
        folder = next(folder for folder in (path, *path.parents) if os.path.isdir(folder))
        try:
            entries = sorted(e.name for e in folder.iterdir() if not e.name.startswith("."))
        except OSError:
            entries = []
        more = ", ..." if len(entries) > SHOWN else ""
        reason = f"{path} is a folder, a file is needed" if is_folder else f"file {path} not found"
        raise MissingFile(reason, f"{folder} has {', '.join(entries[:SHOWN])}{more}")

    def xml(self, path: Path) -> etree._Element:
        """Return the root element of an XML file that the xacro file of a robot includes.

        Raises:
            XacroError: the file is outside the robot's packages.
            InputError: the file is not readable or not valid XML.
        """
        path = self.existing(path)
        text = read_text(path, MAX_TEXT_BYTES)
        self.budget.charge(len(text) // XML_CHARACTERS)
        return parse_xml(text, path)

    def yaml(self, path: Path, evaluate: Any) -> Any:
        """Return the content of a YAML file that a robot's xacro file loads.
        Its keys can be used as attributes.

        Args:
            path: the file.
            evaluate: function that evaluates an expression, for values with a unit such as `!degrees`.
        Raises:
            XacroError: the file is outside the robot's packages.
            InputError: the file is not readable or not valid YAML.
        """
        path = self.existing(path)
        if path not in self._yaml:
            text = read_text(path, MAX_YAML_BYTES)
            self.budget.charge(len(text) // YAML_CHARACTERS)
            self._yaml[path] = self._loaded(text, path, evaluate)
        return self._yaml[path]

    def _loaded(self, text: str, path: Path, evaluate: Any) -> Any:
        class Loader(SafeLoader):
            """Loader for the YAML 1.1 files to which a robot description refers. It reads `yes` as true, as
            ROS does, and supports xacro's units.
            """

        def with_unit(loader: Any, tag: str, node: yaml.Node) -> float:
            if not isinstance(node, yaml.ScalarNode):
                raise XacroError(f"{path}: {tag} needs a number")
            return float(evaluate(str(loader.construct_scalar(node)))) * UNITS[tag]

        for tag in UNITS:
            Loader.add_constructor(tag, lambda loader, node, tag=tag: with_unit(loader, tag, node))
        try:
            check_yaml_events(text, path)
            return self._plain(yaml.load(text, Loader))
        except yaml.MarkedYAMLError as error:
            line = error.problem_mark.line + 1 if error.problem_mark else None
            raise InputError(f"is not valid YAML: {error.problem}", file=path, line=line) from None
        except (yaml.YAMLError, ValueError, TypeError) as error:
            raise InputError(f"is not valid YAML: {error}", file=path) from None

    def _plain(self, value: Any) -> Any:
        """Convert YAML data of a robot file to values for xacro: dicts become `AttributeDict`, dates
        become strings.
        """
        self.budget.charge(1)
        if isinstance(value, dict):
            found = AttributeDict((key, self._plain(item)) for key, item in value.items())
            size(list(found))
            return found
        if isinstance(value, list):
            return [self._plain(item) for item in value]
        if isinstance(value, datetime.date):
            return str(value)
        size(value)
        return value

    def matching(self, pattern: Path) -> list[Path]:
        """Return the files of a robot description that match a path with wildcards (`*`, `?` or `[...]`) in a
        xacro file, sorted.

        Raises:
            XacroError: `..` follows a wildcard, or a match is outside the robot's packages.
        """
        parts = pattern.parts
        first = next(i for i, part in enumerate(parts) if set(part) & set("*?["))
        if ".." in parts[first:]:
            raise XacroError(f"{pattern}: '..' after a wildcard is not supported")
        found = [self.checked(Path(*parts[:first]))]
        for part in parts[first:]:
            inner: list[Path] = []
            for folder in found:
                try:
                    entries = sorted(folder.iterdir()) if os.path.isdir(folder) else []
                except OSError:
                    continue
                self.budget.charge(1 + len(entries))
                inner += [self.checked(e) for e in entries if fnmatch.fnmatchcase(e.name, part)]
            found = inner
        return found
