"""Cells: the cell file (cell.yaml), the loaded `Cell`, and the connected `LiveCell`.

`armcell.load` returns a `Cell`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from armcell.core.gc_pauses import gc_paused

if TYPE_CHECKING:
    from armcell.cell.built_in import built_in_cells, cell_names
    from armcell.cell.cell import Cell
    from armcell.cell.cell_hashes import code_hash, content_hashes
    from armcell.cell.controllers import Controller
    from armcell.cell.live import Arm, LiveCell
    from armcell.cell.live_cameras import LiveCamera, OctomapUpdater
    from armcell.cell.loader import load
    from armcell.cell.objects_file import load_objects, save_objects
    from armcell.cell.setup import SetupProposal, propose, propose_from_package, write_cell
    from armcell.cell.task_run import announce_code, result_of, run_failures, run_task
    from armcell.cell.value_overrides import gains_as_values, parse_value, with_values

# Modules are imported on first use: listing the built-in cells needs neither planner nor physics.
_LAZY = {
    name: f"armcell.cell.{module}"
    for module, names in {
        "built_in": ("built_in_cells", "cell_names"),
        "cell": ("Cell",),
        "controllers": ("Controller",),
        "cell_hashes": ("code_hash", "content_hashes"),
        "live": ("Arm", "LiveCell"),
        "loader": ("load",),
        "objects_file": ("load_objects", "save_objects"),
        "task_run": ("announce_code", "run_failures", "result_of", "run_task"),
        "live_cameras": ("OctomapUpdater", "LiveCamera"),
        "setup": ("SetupProposal", "propose", "propose_from_package", "write_cell"),
        "value_overrides": ("gains_as_values", "parse_value", "with_values"),
    }.items()
    for name in names
}

__all__ = [
    "Arm",
    "Cell",
    "Controller",
    "LiveCamera",
    "LiveCell",
    "OctomapUpdater",
    "SetupProposal",
    "announce_code",
    "built_in_cells",
    "cell_names",
    "code_hash",
    "content_hashes",
    "gains_as_values",
    "load",
    "load_objects",
    "parse_value",
    "propose",
    "propose_from_package",
    "result_of",
    "run_failures",
    "run_task",
    "save_objects",
    "with_values",
    "write_cell",
]


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        with gc_paused():
            return getattr(import_module(_LAZY[name]), name)
    raise AttributeError(f"module 'armcell.cell' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
