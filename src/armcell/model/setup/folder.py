"""Writing a folder whole or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from armcell.core import InputError


def check_folder(folder: Path, force: bool = False) -> None:
    """Say before the work is done that a folder cannot be written.

    Raises:
        InputError: it is there and not empty (and not `force`), it is a file, or its parent is missing.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError("is a file, a folder is needed", file=folder)
    if folder.is_dir() and any(folder.iterdir()) and not force:
        raise InputError("folder is there and not empty", file=folder, cure="name another, or add --force")
    parent = folder.resolve().parent
    if not parent.is_dir():
        raise InputError("folder does not exist", file=parent, cure=f"mkdir -p {parent}")
    try:
        tempfile.TemporaryDirectory(dir=parent).cleanup()
    except OSError as error:
        raise InputError(f"folder is not writable ({error.strerror})", file=parent) from None


def write_folder(folder: Path, files: Mapping[str, str], force: bool = False) -> None:
    """Write text files by their path in the folder. All of them, or nothing is changed.

    A folder that is there keeps its other files; it is replaced in one step.

    Raises:
        InputError: see `check_folder`.
    """
    check_folder(folder, force)
    folder = folder.resolve()
    made = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}."))
    try:
        new, old = made / "new", made / "old"
        if folder.is_dir():
            shutil.copytree(folder, new, symlinks=True)
        new.mkdir(exist_ok=True)
        for name, text in files.items():
            file = new / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, encoding="utf-8")
        if folder.is_dir():
            os.rename(folder, old)
        try:
            os.rename(new, folder)
        except OSError:
            if old.is_dir():
                os.rename(old, folder)
            raise
    finally:
        shutil.rmtree(made, ignore_errors=True)


class _Dumper(yaml.SafeDumper):
    """Lists are indented below their key, as MoveIt's files have them; nothing is written as an alias."""

    def increase_indent(self, flow: bool = False, indentless: bool = False) -> Any:
        return super().increase_indent(flow, False)

    def ignore_aliases(self, data: Any) -> bool:
        return True


def yaml_text(data: Any, *comments: str) -> str:
    """YAML with lines of comment above it."""
    head = "".join(f"# {line}\n" for line in comments)
    return head + yaml.dump(data, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=110)
