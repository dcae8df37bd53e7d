"""Tasks as Python scripts: a file beside cell.yaml with a function `task(cell)`.

A script is the only code that armcell runs from a cell, and only `load_script` runs it. `load_script` logs
the file name first. Commands that start other processes or connect arms before they load the script call
`announce_code` themselves, so that the log line comes first.
"""

from __future__ import annotations

import logging
import os
import runpy
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from armcell.cell.live import LiveCell
from armcell.core import InputError, Outcome

if TYPE_CHECKING:
    from armcell.cell.cell import Cell

log = logging.getLogger(__name__)

Script = Callable[[LiveCell], Outcome | None]
_announced: set[Path] = set()


def announce_code(cell: Cell, origin: str = "") -> None:
    """Log once per process which Python script runs as the task of a cell. Built-in cells log nothing.

    Args:
        origin: the source of the cell, if another user created it.
    """
    if cell.spec.script is not None:
        with suppress(InputError):  # `load_script` reports the error
            _announce(_file_of(cell.spec.script, cell.file), origin)


def load_script(name: str, cell_file: Path) -> Script:
    """Load the Python task script of a cell and return its function `task`.

    Loading runs the top-level code of the file, like an import.

    Raises:
        InputError: the file does not exist in the cell's folder, or it has no function `task`.
    """
    file = _file_of(name, cell_file)
    _announce(file)
    found: Any = runpy.run_path(str(file)).get("task")
    if not callable(found):
        raise InputError("has no function task(cell)", file=file)
    script: Script = found  # pyright: ignore[reportAssignmentType]
    return script


def _file_of(name: str, cell_file: Path) -> Path:
    file = (cell_file.parent / name).resolve()
    where = {"file": cell_file, "element": "script"}
    if cell_file.parent.resolve() not in file.parents or file.suffix != ".py":
        raise InputError(f"{name!r} is not a Python file in the cell's folder", **where)
    if not os.path.isfile(file):
        raise InputError(f"{name!r} does not exist", hint="put it beside the cell file", **where)
    return file


def _announce(file: Path, origin: str = "") -> None:
    own = Path(__file__).resolve().parent
    if file in _announced or own in file.parents:
        return
    _announced.add(file)
    log.warning("armcell runs Python code of this cell%s: %s", f" ({origin})" if origin else "", file)
