"""The cell file and the live cell; what `armcell.load` returns."""

from armcell.cell.cell import Cell, built_in_cells, cell_names, load
from armcell.cell.identity import code_hash, content_hashes
from armcell.cell.live import Arm, LiveCell
from armcell.cell.objects_file import load_objects, save_objects
from armcell.cell.run import complaints, result_of, run_task
from armcell.cell.script import announce_code
from armcell.cell.seeing import CameraWatch, LiveCamera
from armcell.cell.setup import Proposal, propose, propose_from_package, write_cell
from armcell.cell.values import parsed, with_values

__all__ = [
    "Arm",
    "CameraWatch",
    "Cell",
    "LiveCamera",
    "LiveCell",
    "Proposal",
    "announce_code",
    "built_in_cells",
    "cell_names",
    "code_hash",
    "complaints",
    "content_hashes",
    "load",
    "load_objects",
    "parsed",
    "propose",
    "propose_from_package",
    "result_of",
    "run_task",
    "save_objects",
    "with_values",
    "write_cell",
]
