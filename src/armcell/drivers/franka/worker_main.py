"""Entry point of the worker process, without the rest of armcell.

The process is therefore ready after half a second.
"""

import sys
from pathlib import Path
from types import ModuleType


def _bare(name: str, folder: Path) -> None:
    """Register a package for the worker without running its `__init__`, which would import all drivers."""
    package = ModuleType(name)
    package.__path__ = [str(folder)]
    sys.modules[name] = package


if __name__ == "__main__":
    here = Path(__file__).resolve().parent
    sys.path[0] = str(here.parents[2])
    _bare("armcell.drivers", here.parent)
    _bare("armcell.drivers.franka", here)
    from armcell.drivers.franka.worker import main

    main(*sys.argv[1:])
