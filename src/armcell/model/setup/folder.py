"""Atomic writing of a folder: either all files are written or nothing changes."""

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
    """Check in advance that a folder can be written atomically. Raise an error if it cannot.

    Raises:
        InputError: the folder is not empty (without `force`), is a file, has no parent folder, or its parent
            is not writable.
    """
    if os.path.exists(folder) and not os.path.isdir(folder):
        raise InputError("is a file, a folder is needed", file=folder)
    if os.path.isdir(folder) and any(folder.iterdir()) and not force:
        raise InputError("folder is there and not empty", file=folder, hint="name another, or add --force")
    parent = folder.resolve().parent
    if not os.path.isdir(parent):
        raise InputError("folder does not exist", file=parent, hint=f"mkdir -p {parent}")
    try:
        tempfile.TemporaryDirectory(dir=parent, prefix=".armcell-").cleanup()
    except OSError as error:
        raise InputError(f"folder is not writable ({error.strerror})", file=parent) from None


def write_folder(folder: Path, files: Mapping[str, str], force: bool = False) -> None:
    """Write text files into a folder atomically: either all files are written or nothing changes.

    An existing folder keeps its other files and is replaced in one step.

    Args:
        folder: the folder to write.
        files: text by path relative to the folder.
        force: whether the folder may already contain files.
    Raises:
        InputError: see `check_folder`.
    """
    check_folder(folder, force)
    folder = folder.resolve()
    made = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}."))
    try:
        new, old = made / "new", made / "old"
        if os.path.isdir(folder):
            shutil.copytree(folder, new, symlinks=True)
        new.mkdir(exist_ok=True)
        for name, text in files.items():
            file = new / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, encoding="utf-8")
        if os.path.isdir(folder):
            os.rename(folder, old)
        try:
            os.rename(new, folder)
        except OSError:
            if os.path.isdir(old):
                os.rename(old, folder)
            raise
    finally:
        shutil.rmtree(made, ignore_errors=True)


class _Dumper(yaml.SafeDumper):
    """YAML writer that formats generated files as MoveIt does, with indented lists and without aliases."""

    def increase_indent(self, flow: bool = False, indentless: bool = False) -> Any:
        return super().increase_indent(flow, False)

    def ignore_aliases(self, data: Any) -> bool:
        return True


def yaml_text(data: Any, *comments: str) -> str:
    """Return data as YAML text for a file of a generated folder. The text begins with comment lines."""
    head = "".join(f"# {line}\n" for line in comments)
    return head + yaml.dump(data, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=110)
