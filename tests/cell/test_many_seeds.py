"""The promise of the built-in cells, on ten draws each."""

from __future__ import annotations

import pytest
from tests.sizes import seeds

import armcell
from armcell.cell import run_task


@pytest.mark.slow
@pytest.mark.cases("*-0")
@pytest.mark.parametrize("seed", seeds(3, range(10)))
@pytest.mark.parametrize("name", ["panda_pick", "six_axis_pick"])
def test_every_seed_succeeds(name, seed):
    cell = armcell.load(name)
    with cell.connect("sim", seed=seed) as live:
        result = run_task(cell, live, seed, "sim")
    assert result["success"], result["message"]
    assert result["unwanted_contacts"] == []
    assert result["welds"] == []
    assert result["slip_m"] <= 0.5e-3
    assert result["placement_error_m"] <= 5e-3
    assert result["min_clearance_m"] > 0
