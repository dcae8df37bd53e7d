"""No two files of armcell import each other, directly or in a loop, not even in functions or for types."""

import ast
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

SOURCES = Path(__file__).parents[2] / "src"


def module_of(file: Path) -> str:
    return ".".join(file.relative_to(SOURCES).with_suffix("").parts)


def imported(file: Path, modules: set[str]) -> set[str]:
    """Modules that a file imports; not packages, whose `__init__.py` only passes names on."""
    names = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return names & modules - {module_of(file)}


def test_no_cycle_between_files():
    files = [file for file in SOURCES.rglob("*.py") if file.name != "__init__.py"]
    modules = {module_of(file) for file in files}
    imports = {module_of(file): imported(file, modules) for file in files}
    assert sum(map(len, imports.values())) > 1000
    try:
        TopologicalSorter(imports).prepare()
    except CycleError as error:
        raise AssertionError(" -> ".join(error.args[1])) from None
