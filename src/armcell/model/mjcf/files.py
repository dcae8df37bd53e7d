"""Reading of MJCF files as one text, with includes expanded and asset paths made absolute.

The file and line of every element are recorded.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from pathlib import Path

from lxml import etree

from armcell.core import InputError
from armcell.model.assets import MAX_MESH_BYTES
from armcell.model.untrusted_files import MAX_TEXT_BYTES, parse_xml, read_text

MAX_INCLUDES = 30  # depth of nested includes
_FOLDERS = {"mesh": "meshdir", "hfield": "assetdir", "skin": "assetdir", "model": None}
"""Asset elements with a file, and the compiler attribute that names the file's folder."""
_LINE = re.compile(r"line[ =]+(\d+)")
_NAME = re.compile(r"(?:name|Object name)[ =]+'?([^\s',]+)'?")


@dataclass
class MjcfText:
    """Text of an MJCF file in which includes are expanded, with the source file and line of each element.

    Attributes:
        file: the main file.
        text: MJCF without includes, textures and relative paths.
        places: (file, line) of each element of `text`, in document order.
    """

    file: Path
    text: str = ""
    places: list[tuple[Path, int]] = field(default_factory=list)

    def failed(self, message: str) -> InputError:
        """Return an `InputError` for a message from MuJoCo about an MJCF file, with the file and line."""
        reason = " ".join(message.split()).removeprefix("Error: ")
        place = self._of_line(message) or self._of_name(message)
        file, line = place or (self.file, None)
        return InputError(f"MuJoCo rejects the model: {_LINE.sub('', reason)}", file=file, line=line)

    def _of_line(self, message: str) -> tuple[Path, int] | None:
        found = _LINE.search(message)
        if found is None:
            return None
        elements = etree.fromstring(self.text.encode()).iter()
        exact = (place for e, place in zip(elements, self.places) if e.sourceline == int(found[1]))
        return next(exact, None)

    def _of_name(self, message: str) -> tuple[Path, int] | None:
        for found in _NAME.finditer(message):
            elements = etree.fromstring(self.text.encode()).iter()
            named = (place for e, place in zip(elements, self.places) if e.get("name") == found[1])
            if (place := next(named, None)) is not None:
                return place
        return None


def read_mjcf(file: Path) -> MjcfText:
    """Read an MJCF file and all files that it includes. References to textures are removed.

    armcell needs no textures, because it draws links in plain colors; a missing image would be an error.

    Raises:
        InputError: a file is missing, too large or not valid XML, includes are nested too deeply, or the root
            element is not <mujoco>.
    """
    root = parse_xml(read_text(file), file)
    if root.tag != "mujoco":
        raise InputError(
            f"root element is <{root.tag}>, not <mujoco>", file=file, line=root.sourceline,
            hint="is this an MJCF file?",
        )  # fmt: skip
    _Expansion(file.resolve().parent).children(root, file, 0)
    _without_textures(root)
    _with_full_paths(root, file.resolve().parent)
    found = MjcfText(file)
    for element in root.iter():
        url = element.getroottree().docinfo.URL if element.get(_FILE) is None else element.attrib.pop(_FILE)
        line = element.attrib.pop(_LINE_KEY, None)
        found.places.append((Path(url or file), int(line) if line else element.sourceline or 0))
    found.text = etree.tostring(root, encoding="unicode")
    return found


_FILE, _LINE_KEY = "armcell_file", "armcell_line"
"""Temporary XML attributes that record the file and line of an included MJCF element."""


class _Expansion:
    def __init__(self, folder: Path):
        self.folder = folder  # MuJoCo resolves includes from the main file's folder
        self.size = 0

    def children(self, element: etree._Element, file: Path, depth: int) -> None:
        for child in list(element):
            if child.tag != "include":
                self.children(child, file, depth)
                continue
            at = element.index(child)
            for offset, included in enumerate(self.included(child, file, depth)):
                element.insert(at + offset, included)
            element.remove(child)

    def included(self, element: etree._Element, file: Path, depth: int) -> list[etree._Element]:
        where = {"file": file, "line": element.sourceline, "element": "<include>"}
        name = element.get("file")
        if not name:
            raise InputError("attribute 'file' is missing", **where)
        if depth >= MAX_INCLUDES:
            raise InputError(f"includes are nested deeper than {MAX_INCLUDES} levels", **where)
        choices = (self.folder / name, file.resolve().parent / name)
        path = next((p for p in choices if os.path.isfile(p)), None)
        if path is None:
            raise InputError(f"included file {choices[0]} not found", **where, hint="check the path")
        text = read_text(path, MAX_TEXT_BYTES - self.size)
        self.size += len(text)
        root = parse_xml(text, path)
        if root.tag not in ("mujoco", "mujocoinclude"):
            raise InputError(f"includes {path}, whose root element is <{root.tag}>", **where)
        self.children(root, path, depth + 1)
        for inner in root.iter():
            if inner.get(_FILE) is None:
                inner.set(_FILE, str(path))
                inner.set(_LINE_KEY, str(inner.sourceline))
        return list(root)


def _without_textures(root: etree._Element) -> None:
    for element in list(root.iter("texture", "layer")):
        parent = element.getparent()
        if parent is not None and (element.tag == "texture" or parent.tag == "material"):
            parent.remove(element)
    for material in root.iter("material"):
        material.attrib.pop("texture", None)


def _with_full_paths(root: etree._Element, folder: Path) -> None:
    """Replace the relative paths of assets in the text of an MJCF file by absolute paths.

    The compiler's folder attributes determine the paths.

    Raises:
        InputError: a file does not exist or is too large.
    """
    options: dict[str, str] = {}
    for compiler in root.iter("compiler"):
        for key in ("assetdir", "meshdir", "texturedir", "strippath"):
            if key in compiler.attrib:
                options[key] = compiler.attrib.pop(key)
    strip = options.get("strippath") == "true"
    for tag, option in _FOLDERS.items():
        base = folder
        if option is not None:
            base = folder / options.get(option, options.get("assetdir", ""))
        for element in root.iter(tag):
            name = element.get("file")
            if not name:
                continue
            path = base / (Path(name.replace("\\", "/")).name if strip else name)
            label = f"<{tag} file={name!r}>"
            where = {"file": _file_of(element, root), "line": _line_of(element), "element": label}
            if not os.path.isfile(path):
                raise InputError(f"file {path} not found", **where, hint="check meshdir and the path")
            if path.stat().st_size > MAX_MESH_BYTES:
                raise InputError(f"file {path} is larger than {MAX_MESH_BYTES} bytes", **where)
            if tag == "mesh" and element.get("name") is None:
                element.set("name", Path(name).stem)  # MuJoCo's rule, from the path as written
            element.set("file", str(path.resolve()))


def _file_of(element: etree._Element, root: etree._Element) -> str:
    return element.get(_FILE) or str(root.getroottree().docinfo.URL or "")


def _line_of(element: etree._Element) -> int | None:
    line = element.get(_LINE_KEY)
    return int(line) if line else element.sourceline
