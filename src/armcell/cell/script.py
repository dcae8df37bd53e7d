"""A cell's task as a Python script: a file beside cell.yaml with a function `task(cell)`."""

from __future__ import annotations

import os
import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any

from armcell.cell.live import LiveCell
from armcell.core import InputError, Outcome

Script = Callable[[LiveCell], Outcome | None]


def load_script(name: str, cell_file: Path) -> Script:
    """The function `task` of a script. Loading it runs the file's top level, as any import would.

    Raises:
        InputError: no such file beside the cell's, or no function `task` in it.
    """
    file = (cell_file.parent / name).resolve()
    where = {"file": cell_file, "element": "script"}
    if cell_file.parent.resolve() not in file.parents or file.suffix != ".py":
        raise InputError(f"{name!r} is not a Python file in the cell's folder", **where)
    if not os.path.isfile(file):
        raise InputError(f"{name!r} does not exist", cure="put it beside the cell file", **where)
    found: Any = runpy.run_path(str(file)).get("task")
    if not callable(found):
        raise InputError("has no function task(cell)", file=file)
    script: Script = found  # pyright: ignore[reportAssignmentType]
    return script
