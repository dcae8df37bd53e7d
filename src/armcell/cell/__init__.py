"""The cell file and the live cell; what `armcell.load` returns."""

from armcell.cell.cell import Cell, built_in_cells, cell_names, load
from armcell.cell.live import Arm, LiveCell
from armcell.cell.objects_file import load_objects, save_objects
from armcell.cell.run import run_task

__all__ = [
    "Arm",
    "Cell",
    "LiveCell",
    "built_in_cells",
    "cell_names",
    "load",
    "load_objects",
    "run_task",
    "save_objects",
]
