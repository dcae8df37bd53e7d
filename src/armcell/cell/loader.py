"""Loading of cells, with early errors for wrong names and files.

Errors are reported before the planner and physics are imported.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from armcell.cell.built_in import CELL_FILE, LIBRARY, cell_names
from armcell.cell.validation import validated
from armcell.core import UnknownNameError
from armcell.model.untrusted_files import read_yaml

if TYPE_CHECKING:
    from armcell.cell.cell import Cell
    from armcell.model import RobotModel


def load(cell: str | Path, allow_env: bool | None = None, model: RobotModel | None = None) -> Cell:
    """Load a cell, given as the name of a built-in cell, a folder with a file cell.yaml, or a YAML file.

    Args:
        allow_env: lets the robot's xacro files read environment variables, see `load_robot`.
        model: the cell's robot, if it is already loaded.
    Raises:
        InputError: the cell is invalid; the error has the file, the element, the reason and the hint.
    """
    if isinstance(cell, str) and cell in cell_names():
        file = LIBRARY / cell / CELL_FILE
    else:
        path = Path(cell)
        file = path / CELL_FILE if os.path.isdir(path) else path
        if not os.path.exists(file) and isinstance(cell, str) and "/" not in cell and "." not in cell:
            raise UnknownNameError("cell", cell, cell_names())
    name = file.resolve().parent.name if file.name == CELL_FILE else file.stem
    spec = validated(read_yaml(file), file)

    from armcell.cell.cell import Cell  # imported late: takes 1.3 s

    return Cell(name, file, spec, model, allow_env)
