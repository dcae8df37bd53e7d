"""The names that users import from `armcell`."""

import subprocess
import sys
from pathlib import Path

import pytest

import armcell


@pytest.mark.parametrize("name", armcell.__all__)
def test_every_public_name_can_be_imported(name):
    assert getattr(armcell, name) is not None
    assert name in dir(armcell)


@pytest.mark.slow
def test_subpackages_need_no_import_of_their_own():
    code = "import armcell; print(armcell.planning.plan.__name__, armcell.scene.PlanningScene.__name__)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split() == ["plan", "PlanningScene"]


def test_the_import_loads_no_library():
    code = "import sys, armcell; print([m for m in ('numpy', 'numba', 'mujoco', 'coal') if m in sys.modules])"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "[]"


def test_unknown_names_are_attribute_errors():
    with pytest.raises(AttributeError, match="no attribute 'plam'"):
        _ = armcell.plam


def test_types_ship():
    assert (Path(armcell.__file__).parent / "py.typed").exists()
