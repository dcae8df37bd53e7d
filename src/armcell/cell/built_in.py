"""Names, files and descriptions of the built-in cells, without slow imports."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from armcell.model.untrusted_files import read_yaml

LIBRARY = Path(__file__).parent / "library"
CELL_FILE = "cell.yaml"


def cell_names() -> list[str]:
    """Return the sorted names of the built-in cells."""
    return sorted(p.parent.name for p in LIBRARY.glob(f"*/{CELL_FILE}"))


@dataclass(frozen=True)
class CellSummary:
    """The name and description of a built-in cell."""

    name: str
    description: str


def built_in_cells() -> list[CellSummary]:
    """Return the name and description of each built-in cell without loading the cells."""
    return [
        CellSummary(n, str(read_yaml(LIBRARY / n / CELL_FILE).get("description", ""))) for n in cell_names()
    ]
