"""A cell's task as a Python script: a file beside cell.yaml with a function `task(cell)`.

This is the only code that armcell runs from a cell, and `load_script` is the only place that runs it. Before
it does, it says which file. Commands that start other processes, or that connect arms first, call
`announce_code` themselves, so that the line comes before.
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
    """Log which Python files of a cell will run; each file once per process, armcell's own cells never.

    Args:
        origin: where the cell comes from, if it is not this user's.
    """
    if cell.spec.script is not None:
        with suppress(InputError):  # `load_script` says what is wrong with it
            _announce(_file_of(cell.spec.script, cell.file), origin)


def load_script(name: str, cell_file: Path) -> Script:
    """The function `task` of a script. Loading it runs the file's top level, as any import would.

    Raises:
        InputError: no such file beside the cell's, or no function `task` in it.
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
        raise InputError(f"{name!r} does not exist", cure="put it beside the cell file", **where)
    return file


def _announce(file: Path, origin: str = "") -> None:
    own = Path(__file__).resolve().parent
    if file in _announced or own in file.parents:
        return
    _announced.add(file)
    log.warning("armcell runs Python code of this cell%s: %s", f" ({origin})" if origin else "", file)
