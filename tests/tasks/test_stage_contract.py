"""The contract of every registered stage. A new stage is tested by being registered."""

from __future__ import annotations

import dataclasses
import inspect

import pytest

from armcell.core import InputError, UnknownNameError
from armcell.tasks import make_stage, stage_types

each_stage = pytest.mark.parametrize("name", list(stage_types))


def test_every_stage_of_armcell_is_registered():
    """Classes with `propose` in armcell.tasks, but for the protocol and private helpers."""
    import armcell.tasks as tasks

    found = set()
    for module in {inspect.getmodule(make) for make in stage_types.imported().values()} | {tasks}:
        for _, cls in inspect.getmembers(module, inspect.isclass):
            own = cls.__module__.startswith("armcell.tasks") and not cls.__name__.startswith("_")
            if own and hasattr(cls, "propose") and cls.__name__ not in ("Stage", "SearchState", "Pick"):
                found.add(cls)
    assert found and found <= set(stage_types.imported().values())


@each_stage
def test_a_stage_is_an_immutable_value_with_a_name(name):
    cls = stage_types[name]
    assert dataclasses.is_dataclass(cls) and cls.__dataclass_params__.frozen
    assert "name" in inspect.signature(cls).parameters or isinstance(
        inspect.getattr_static(cls, "name"), property | str
    )
    assert list(inspect.signature(cls.propose).parameters) == ["self", "solution", "planning"]
    assert cls.__doc__ and not cls.__doc__.startswith(f"{cls.__name__}(")


@each_stage
def test_declarations_are_tuples_of_names_or_properties(name):
    for kind in ("requires", "provides", "consumes"):
        declared = inspect.getattr_static(stage_types[name], kind, ())
        if not isinstance(declared, property):
            assert isinstance(declared, tuple) and all(isinstance(each, str) for each in declared)


def test_values_of_a_cell_file_are_checked():
    with pytest.raises(UnknownNameError, match="stage 'serial'.*stages"):
        make_stage("serial", {"stagess": ()})
    with pytest.raises(InputError, match="stage 'serial' lacks stages"):
        make_stage("serial", {})
    assert make_stage("serial", {"stages": ()}).name == "serial"
