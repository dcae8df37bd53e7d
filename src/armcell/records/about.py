"""What a record says of its run: all that is needed to run it again."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from armcell.cell import Cell, cell_names, content_hashes, load
from armcell.cell.schema import validated
from armcell.cell.versions import versions
from armcell.core import InputError

FORMAT = 1
"""Of what stands in a record beside the ROS messages."""


def about_run(
    cell: Cell, seed: int | None, mode: str, values: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """JSON-ready: the whole cell (with its other values), seed, mode, hashes, versions, machine."""
    return {
        "format": FORMAT,
        "cell": cell.name,
        "file": str(cell.file.resolve()),
        "built_in": cell.name in cell_names() and load(cell.name).file == cell.file,
        "spec": cell.spec.model_dump(mode="json", exclude_unset=True),
        "values": dict(values or {}),
        "seed": seed,
        "mode": mode,
        "hashes": content_hashes(cell),
        "versions": versions(),
        "machine": this_machine(),
    }


def this_machine() -> str:
    """The computer's name and processor."""
    return f"{platform.node()} {platform.machine()} {platform.processor()}".strip()


def origin_of(about: Mapping[str, Any], file: Path) -> str:
    """Where a record comes from, in words, if it is not this user's own of this computer; else nothing.

    Args:
        file: of the record.
    """
    machine = str(about.get("machine"))
    if machine != this_machine():
        return f"named by a record from another computer, {_printable(machine)}"
    if hasattr(os, "getuid") and file.stat().st_uid != os.getuid():
        return "named by another user's record"
    return ""


def _printable(text: str) -> str:
    return "".join(c if c.isprintable() else "?" for c in text[:80])


def cell_of(about: Mapping[str, Any]) -> Cell:
    """The cell that was run, as it was then; what its file now says does not matter.

    Meshes, scripts and robots that are files of their own are read anew: see `changed_since`.

    Raises:
        InputError: a file it needs is gone.
    """
    name, file = str(about["cell"]), Path(about["file"])
    if about.get("built_in") and name in cell_names():
        file = load(name).file  # perhaps armcell is installed elsewhere
    return Cell(name, file, validated(dict(about["spec"]), file))


def changed_since(about: Mapping[str, Any], cell: Cell) -> list[str]:
    """What is not as it was when the record was made, in words; empty if a run must repeat to the bit."""
    then, now = about["hashes"], content_hashes(cell)
    found = []
    for part in sorted({*then, *now}):
        if then.get(part) != now.get(part):
            _, _, library = part.partition("versions.")
            was, here = (m.get(library) for m in (about["versions"], versions()))
            found.append(f"{library} {was} -> {here}" if library else part)
    return found


def checked_about(data: Any, file: Path) -> dict[str, Any]:
    """What a record says of its run, if this armcell can read it.

    Raises:
        InputError: of another version.
    """
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        has = data.get("format") if isinstance(data, dict) else "nothing"
        raise InputError(
            f"is a record of format {has}, this armcell reads {FORMAT}", file=file,
            cure="the ROS messages in it still open in Foxglove",
        )  # fmt: skip
    return data
