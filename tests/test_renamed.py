"""Programs that use renamed names: the traceback says the new name, and each new name exists."""

import subprocess
import sys
from importlib import import_module

import pytest

from armcell import _renamed

PROGRAMS = {
    "from armcell.control import Driver": "armcell.drivers",
    "import armcell; armcell.control": "armcell.drivers",
    "from armcell.planning import violations": "armcell.planning.describe_violations",
    "import armcell; armcell.tasks.prove": "armcell.tasks.prove_grasps",
    "from armcell.core import InputError; InputError('bad', cure='mend it')": "cure is now hint",
    "from armcell.core import InputError; InputError('bad').cure": "cure is now hint",
    "from armcell.execution import execute; execute(trajectory=None)": "trajectory is now motion",
}
OTHER_ERRORS = (
    "1 / 0",
    "import armcell.nothing",
    "from armcell.core import nothing",
    "object().cure",
    "int(trajectory=1)",
    "from armcell.core import InputError; raise InputError('bad')",
)


def traceback_of(program):
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert run.returncode == 1
    return run.stderr


@pytest.mark.parametrize("program", PROGRAMS)
def test_the_traceback_ends_with_the_new_name(program):
    assert PROGRAMS[program] in traceback_of(program).splitlines()[-1]


@pytest.mark.parametrize("program", OTHER_ERRORS)
def test_other_tracebacks_stay_as_they_are(program):
    assert "renamed" not in traceback_of(program)


@pytest.mark.parametrize("old, new", _renamed.NAMES.items())
def test_the_new_name_exists_and_the_old_one_does_not(old, new):
    package, _, name = new.partition(" ")[0].rpartition(".")
    assert name in import_module(f"armcell.{package}").__all__
    assert old != new
    package, _, name = old.rpartition(".")
    if package not in _renamed.PACKAGES:
        assert not hasattr(import_module(f"armcell.{package}"), name)


def test_renamed_packages_are_gone():
    for old in _renamed.PACKAGES:
        with pytest.raises(ModuleNotFoundError) as caught:
            import_module(f"armcell.{old}")
        assert "armcell." in _renamed.new_name(caught.value)
