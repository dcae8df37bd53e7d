"""Check of the cell that `armcell setup` or `armcell new` has written: its robot picks and places."""

from __future__ import annotations

from pathlib import Path

import armcell
from armcell.cell import run_task


def check_starter(folder: Path) -> None:
    """Assert that the cell's task places its object in physics, without unwanted contacts or welds."""
    assert "place:" in (folder / "cell.yaml").read_text()
    cell = armcell.load(folder)
    with cell.connect("sim", seed=0) as live:
        result = run_task(cell, live, 0, "sim")
    assert result["success"], result["message"]
    assert result["unwanted_contacts"] == [] and result["welds"] == []
