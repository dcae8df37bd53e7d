"""docs/cells.md names every built-in cell and every setting, with the default that it has."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from pathlib import Path

import pytest

from armcell.cell import cell_names
from armcell.execution import ExecutionSettings
from armcell.sim import PhysicsSettings
from armcell.tasks import TaskSettings

PAGE = (Path(__file__).parents[2] / "docs/cells.md").read_text()


def rows() -> dict[str, str]:
    """Each name in the first column of a table, to its whole row."""
    found = {}
    for line in PAGE.splitlines():
        if line.startswith("| `"):
            for name in line.split("|")[1].replace("`", "").split(","):
                found[name.strip()] = line
    return found


def test_every_cell_is_there():
    assert set(cell_names()) <= set(rows())


@pytest.mark.parametrize("made", [TaskSettings(), PhysicsSettings()], ids=lambda made: type(made).__name__)
def test_every_setting_and_its_default(made):
    for field in fields(made):
        row, value = rows()[field.name], getattr(made, field.name)
        numbers = [str(value)] if not is_dataclass(value) else [str(getattr(value, "velocity", ""))]
        assert all(number in row for number in numbers), f"{field.name} is {value}, the page says: {row}"


def test_tolerances_of_execution():
    for field in fields(ExecutionSettings):
        assert f"`{field.name}` {getattr(ExecutionSettings(), field.name)}" in PAGE
