"""docs/coming_from_moveit.md: its code runs, and the commands and names it tells of exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import armcell.core
import armcell.planning
import armcell.scene
from armcell.cli.main import app
from armcell.core import CartesianRequest, JointGoal, PlanRequest, PoseGoal

PAGE = (Path(__file__).parents[2] / "docs" / "coming_from_moveit.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, flags=re.S)


@pytest.mark.slow
def test_the_code_blocks_run_one_after_the_other(capsys):
    names: dict = {}
    for block in BLOCKS:
        exec(compile(block, "coming_from_moveit.md", "exec"), names)
    said = capsys.readouterr().out
    assert len(BLOCKS) >= 6
    assert "CONTROL_FAILED" in said and "NO_IK_SOLUTION" in said and "ompl" in said


def test_the_commands_exist():
    told = set(re.findall(r"`armcell ([a-z-]+)", PAGE))
    known = {command.name for command in (*app.registered_commands, *app.registered_groups)}
    assert {"setup", "plan", "ik", "doctor", "explain"} <= told <= known


def test_the_arguments_of_requests_exist():
    """Whatever is named in a call like PlanRequest(attempts=4)."""
    for kind in (PlanRequest, CartesianRequest, JointGoal, PoseGoal):
        for arguments in re.findall(rf"`{kind.__name__}\(([^`]*)\)`", PAGE):
            for name in re.findall(r"(\w+)=", re.sub(r"\(.*\)", "", arguments)):
                assert name in kind.__dataclass_fields__, (kind.__name__, name)


def test_the_names_of_the_tables_exist():
    """Classes and functions in the right-hand columns come from the rooms that the page imports from."""
    rooms = (armcell.core, armcell.planning, armcell.scene)
    right = [row.split("|")[2] for row in PAGE.splitlines() if row.startswith("| `") and row.count("|") == 3]
    called = {name for cell in right for name in re.findall(r"(?<![\w.])([A-Z]\w+)\(", cell)}
    elsewhere = {"ExactChecker", "KernelChecker", "BlendedPath", "MoveItConfig"}
    unknown = {n for n in called - elsewhere if not any(hasattr(room, n) for room in rooms)}
    assert len(called) >= 12 and not unknown
