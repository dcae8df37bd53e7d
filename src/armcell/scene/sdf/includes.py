"""Lookup of the files that SDF's URIs refer to: models of <include>, and meshes."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from armcell.core import InputError
from armcell.model.assets import resolve_uri
from armcell.model.untrusted_files import parse_xml, read_text
from armcell.scene.sdf.elements import Element, children, fail

VARIABLES = (
    "GAZEBO_MODEL_PATH", "GZ_SIM_RESOURCE_PATH", "IGN_GAZEBO_RESOURCE_PATH", "GAZEBO_RESOURCE_PATH",
    "SDF_PATH",
)  # fmt: skip
CONFIG, MODEL = "model.config", "model.sdf"
MAX_CONFIG_BYTES = 1_000_000
ABOVE = 4  # number of folders above a file that are searched for sibling models


class ResourceFinder:
    """Finder of the model and mesh files that an SDF file includes by URI.

    The search covers the given folders, Gazebo's search path and the folders around the file.
    """

    def __init__(self, folders: Sequence[Path] = ()):
        named = [
            Path(entry)
            for variable in VARIABLES
            for entry in os.environ.get(variable, "").split(os.pathsep)
            if entry
        ]
        self.folders = [*folders, *named]

    def _candidates(self, rest: str, base: Path) -> Iterator[Path]:
        """Yield candidate paths for the URI model://NAME/... of an SDF <include>: first in the search
        folders, then in the folders around the SDF file, innermost first.
        """
        above = [base, *base.parents][: ABOVE + 1]
        for folder in (*self.folders, *above):
            yield folder / rest
            yield folder / "models" / rest
            head, _, inner = rest.partition("/")
            if folder.name == head:  # the folder is the model itself
                yield folder / inner if inner else folder

    def find(self, uri: str, base: Path, asked_by: Element) -> Path:
        """Return the existing file or folder to which a URI refers, with which an SDF file includes a model
        or mesh.

        Args:
            uri: model://, package://, file:// or a path. Of a web address, only the model's name is used.
            base: folder of the file that contains the URI.
            asked_by: the element that contains the URI, for error messages.
        Raises:
            InputError: nothing was found; the message names the searched folders.
        """
        scheme, separator, rest = uri.partition("://")
        if not separator:
            scheme, rest = "", uri
        elif scheme in ("http", "https"):  # Fuel's .../OWNER/models/NAME[/VERSION][/files/...]
            parts = [part for part in rest.split("/") if part]
            at = parts.index("models") if "models" in parts else len(parts) - 2
            rest = parts[at + 1] if at + 1 < len(parts) else ""
        rest = rest.strip("/") if scheme not in ("file", "") else rest
        if not rest or (".." in Path(rest).parts and scheme not in ("", "file")) or "\0" in rest:
            raise fail(asked_by, f"{uri!r} is not a valid URI")
        paths = [base / rest] if scheme in ("", "file") else []
        paths += [] if os.path.isabs(rest) else list(self._candidates(rest, base))
        for path in paths:
            if os.path.exists(path):
                return path
        if scheme == "package":
            try:
                return resolve_uri(uri, base)
            except InputError as error:
                raise fail(asked_by, error.reason, error.hint) from None
        raise fail(
            asked_by,
            f"{uri} not found in {', '.join(map(str, self.folders)) or 'a search path'} or above {base}",
            "name the folder that holds the model with --package FOLDER or in GZ_SIM_RESOURCE_PATH"
            + ("; armcell downloads nothing" if scheme.startswith("http") else ""),
        )  # fmt: skip

    def model_file(self, uri: str, base: Path, asked_by: Element) -> Path:
        """Return the SDF file of a model that is included by its URI.

        The URI refers to the file itself, or to a folder whose model.config names the file (the highest SDF
        version).

        Raises:
            InputError: the model was not found.
        """
        path = self.find(uri, base, asked_by)
        if os.path.isfile(path):
            return path
        config = path / CONFIG
        if os.path.isfile(config):
            entries = children(parse_xml(read_text(config, MAX_CONFIG_BYTES), config), "sdf")
            entries.sort(key=lambda entry: _version(entry.get("version", "")))
            if entries and (entries[-1].text or "").strip():
                return path / (entries[-1].text or "").strip()
        if os.path.isfile(path / MODEL):
            return path / MODEL
        raise fail(asked_by, f"{path} has neither {CONFIG} nor {MODEL}", "is this a Gazebo model's folder?")


def _version(text: str) -> tuple[int, ...]:
    return tuple(int(part) if part.isdecimal() and len(part) < 9 else 0 for part in text.split("."))
