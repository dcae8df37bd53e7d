"""The Python block of docs/moveit_scripts.md runs, and its tables name what there is."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

import pytest
from tests import programs

import armcell
from armcell.cell import cell_names
from armcell.moveit import lint

PAGE = Path(__file__).parents[2] / "docs" / "moveit_scripts.md"


@pytest.mark.slow
def test_the_block_runs(tmp_path):
    (block,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(), flags=re.S)
    environment = {**os.environ, "PYTHONPATH": str(Path(armcell.__file__).parents[1])}
    done = programs.run(
        [sys.executable, "-c", block],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr


def test_the_rules_and_cells_are_those_there_are():
    text = PAGE.read_text()
    source = Path(lint.__file__).read_text()
    table = text.partition("| rule | trap |")[2].partition("\n## ")[0]
    named = {
        name
        for row in table.splitlines()
        for name in re.findall(r"`([a-z-]+)`", row.split("|")[1] if "|" in row else "")
    }
    assert named and all(f'"{name}"' in source for name in named)
    for cell in ("panda_table", "six_axis_table", "dual_ur10"):
        assert f"`{cell}`" in text and cell in cell_names()
