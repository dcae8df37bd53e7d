"""Run metadata in a record: everything that is needed to execute the run again."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from armcell.cell import Cell, cell_names, content_hashes, load
from armcell.cell.cell_hashes import versions
from armcell.cell.validation import validated
from armcell.core import InputError

FORMAT = 1
"""Format version of the metadata in a record."""


def run_metadata(
    cell: Cell, seed: int | None, mode: str, values: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Return the metadata of a run as JSON-compatible data, which suffices to execute the run again.

    The metadata are the cell with changed values, the seed, mode, content hashes, versions and machine.

    Args:
        values: values that replaced those of the cell file, by path.
    """
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
    """Return the name and the processor of this computer, for the metadata of a record."""
    return f"{platform.node()} {platform.machine()} {platform.processor()}".strip()


def origin_of(metadata: Mapping[str, Any], file: Path) -> str:
    """Describe the origin of a record that another user or computer wrote, from its metadata.
    Return an empty text for other records.

    Args:
        metadata: run metadata of the record.
        file: file of the record.
    """
    machine = str(metadata.get("machine"))
    if machine != this_machine():
        return f"named by a record from another computer, {_printable(machine)}"
    if hasattr(os, "getuid") and file.stat().st_uid != os.getuid():
        return "named by another user's record"
    return ""


def _printable(text: str) -> str:
    return "".join(c if c.isprintable() else "?" for c in text[:80])


def recorded_cell(metadata: Mapping[str, Any]) -> Cell:
    """Return the cell that is stored in the metadata of a record, even if the cell file has changed since.

    Meshes, scripts and robots in separate files are read in their current version; see `changed_since`.

    Raises:
        InputError: a file of the cell is missing.
    """
    name, file = str(metadata["cell"]), Path(metadata["file"])
    if metadata.get("built_in") and name in cell_names():
        file = load(name).file  # armcell may be installed in another folder now
    return Cell(name, file, validated(dict(metadata["spec"]), file))


def changed_since(metadata: Mapping[str, Any], cell: Cell) -> list[str]:
    """List which parts of a cell and which library versions differ from those in the metadata of a record.

    An empty list means that executing the run again must give bit-identical results.
    """
    then, now = metadata["hashes"], content_hashes(cell)
    found = []
    for part in sorted({*then, *now}):
        if then.get(part) != now.get(part):
            _, _, library = part.partition("versions.")
            was, here = (m.get(library) for m in (metadata["versions"], versions()))
            found.append(f"{library} {was} -> {here}" if library else part)
    return found


def checked_metadata(data: Any, file: Path) -> dict[str, Any]:
    """Return the run metadata of a record after checking its format version.

    Raises:
        InputError: the record has another format version.
    """
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        has = data.get("format") if isinstance(data, dict) else "nothing"
        raise InputError(
            f"is a record of format {has}, this armcell reads {FORMAT}", file=file,
            hint="the ROS messages in it still open in Foxglove",
        )  # fmt: skip
    return data
