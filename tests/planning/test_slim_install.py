"""The slim install of docs/commands.md: planning imports only the packages of requirements-planning.txt."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FILE = ROOT / "requirements-planning.txt"
MODULES = {"pycollada": "collada", "pyyaml": "yaml"}
REQUIRED_BY_THOSE = {"cmeel", "eigenpy", "hppfcl", "llvmlite"}

PROGRAM = """
import sys
from importlib.metadata import packages_distributions

absent = set(packages_distributions()) - set(sys.argv[1].split())

class Missing:
    def find_spec(self, name, path=None, target=None):
        if name in absent:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Missing())

from armcell import load_robot
from armcell.core import JointGoal, JointState, PlanRequest
from armcell.planning import plan
from armcell.scene import PlanningScene

model = load_robot("palletizer")
names = model.group("arm").joint_names
goal = JointState(names, model.default_positions()[model.columns(names)] + 0.1)
result = plan(PlanningScene.of(model), PlanRequest("arm", (JointGoal(goal),)))
print(result.code.name)
for name in ("mujoco", "matplotlib", "typer", "viser"):
    assert name not in sys.modules
"""


def pins(file: Path) -> dict[str, str]:
    return dict(re.findall(r"^([\w.-]+)==(\S+)", file.read_text(), re.MULTILINE))


def test_the_pins_are_those_of_the_whole_install():
    assert pins(FILE).items() <= pins(ROOT / "requirements.txt").items()


@pytest.mark.slow
def test_planning_imports_no_other_package():
    allowed = {MODULES.get(name, name) for name in pins(FILE)} | REQUIRED_BY_THOSE | {"armcell"}
    run = subprocess.run(
        [sys.executable, "-c", PROGRAM, " ".join(allowed)], capture_output=True, text=True, timeout=300
    )
    assert run.stdout.strip() == "SUCCESS", run.stdout + run.stderr
