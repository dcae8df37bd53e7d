"""Registries: lookup, and components of installed packages, also of broken ones."""

from __future__ import annotations

import logging
import sys

import pytest

from armcell.core import Registry, UnknownNameError
from armcell.core import registry as module

GROUP = "armcell.test_parts"
parts: Registry[int] = Registry("part", GROUP)


def install(folder, name: str, code: str) -> None:
    """Write a package as pip installs it: a module, and metadata with an entry point."""
    (folder / f"{name}.py").write_text(code)
    info = folder / f"{name}-1.2.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.2\n")
    (info / "entry_points.txt").write_text(f"[{GROUP}]\n{name} = {name}\n")


@pytest.fixture
def site(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    before = set(sys.modules)
    yield tmp_path
    module._loaded.discard(GROUP)
    parts._items.clear()
    for name in set(sys.modules) - before:
        del sys.modules[name]


REGISTERS = "from tests.core.test_registry import parts\nparts.register({name!r})({value})\n"


def test_names_are_unique_and_unknown_ones_list_the_known():
    registry: Registry[int] = Registry("part")
    registry.register("bolt")(1)
    with pytest.raises(ValueError, match="'bolt' is registered twice"):
        registry.register("bolt")(2)
    with pytest.raises(UnknownNameError, match="unknown part 'bult'; known: bolt.*did you mean 'bolt'"):
        registry["bult"]
    assert registry["bolt"] == 1 and list(registry) == ["bolt"] and len(registry) == 1


@pytest.mark.parametrize("use", [lambda: parts["nut"], lambda: "nut" in parts, lambda: list(parts)])
def test_an_installed_package_adds_its_component(site, use):
    install(site, "nut_package", REGISTERS.format(name="nut", value=7))
    assert use() and parts["nut"] == 7


def test_packages_are_loaded_only_for_unknown_names(site):
    install(site, "nut_package", REGISTERS.format(name="nut", value=7))
    parts.register("own")(1)
    assert parts["own"] == 1 and parts.imported() == {"own": 1}
    assert "nut_package" not in sys.modules


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        ("1 / 0", "ZeroDivisionError: division by zero"),
        ("import no_such_module_of_mine", "ModuleNotFoundError: No module named 'no_such_module_of_mine'"),
        ("raise SystemExit(3)", "SystemExit: 3"),
        ("def f(:", "SyntaxError"),
        (REGISTERS.format(name="own", value=9), "ValueError: part 'own' is registered twice"),
    ],
)
def test_a_broken_package_is_named_and_the_others_work(site, caplog, code, reason):
    parts.register("own")(1)
    install(site, "broken_package", code)
    install(site, "nut_package", REGISTERS.format(name="nut", value=7))
    with caplog.at_level(logging.WARNING):
        assert parts["nut"] == 7
    (record,) = [r for r in caplog.records if r.levelno >= logging.WARNING]
    text = record.getMessage()
    assert "broken_package 1.2" in text and GROUP in text and reason in text
    assert parts["own"] == 1
    caplog.clear()
    assert "bult" not in parts and not caplog.records  # once
