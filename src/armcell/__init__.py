"""armcell: a robot work cell in one install.

Plan like MoveIt, grasp in real physics, run the same task on simulated or real arms.

    import armcell

    cell = armcell.load("panda_pick")
    with cell.connect(mode="sim") as live:
        live.arm.pick("cube")
        live.arm.place("cube", on="tray")
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from armcell._cache import use_cache

use_cache()  # before anything imports numba

__version__ = "0.1.0"

if TYPE_CHECKING:
    from armcell.cell import Cell, load
    from armcell.model import RobotModel, load_robot

# Imported on first use, so that `import armcell` and `armcell --help` stay quick.
_LAZY = {
    "load": "armcell.cell",
    "Cell": "armcell.cell",
    "load_robot": "armcell.model",
    "RobotModel": "armcell.model",
}

__all__ = ["Cell", "RobotModel", "__version__", "load", "load_robot"]


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        from importlib import import_module

        return getattr(import_module(_LAZY[name]), name)
    raise AttributeError(f"module 'armcell' has no attribute {name!r}")
