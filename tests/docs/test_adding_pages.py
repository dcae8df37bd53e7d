"""Each "Adding a ..." page, followed step by step in a scratch package that pip installs."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import armcell

DOCS = Path(__file__).parents[2] / "docs"
PAGES = sorted(page.stem for page in DOCS.glob("adding_a_*.md"))
OWN_TEST = {"adding_a_driver"}  # tests/drivers/test_adding_a_driver.py
FILE = re.compile(r'^```\w+ title="([^"]+)"\n(.*?)^```', re.M | re.S)


def run(command: list[str], folder: Path, installed: Path) -> subprocess.CompletedProcess:
    path = os.pathsep.join([str(installed), str(Path(armcell.__file__).parents[1])])
    return subprocess.run(
        command, cwd=folder, capture_output=True, text=True, timeout=900,
        env={**os.environ, "PYTHONPATH": path},
    )  # fmt: skip


def test_every_page_is_in_the_navigation():
    navigation = (DOCS.parent / "mkdocs.yml").read_text()
    assert all(f"{page}.md" in navigation for page in PAGES)
    assert {"adding_a_planner", "adding_a_gripper", "adding_a_wire", "adding_a_camera"} <= set(PAGES)


@pytest.mark.slow
@pytest.mark.cases("adding_a_wire")
@pytest.mark.parametrize("page", sorted(set(PAGES) - OWN_TEST))
def test_the_steps_work(page, tmp_path):
    text = (DOCS / f"{page}.md").read_text()
    files = dict(FILE.findall(text))
    assert "try_it.py" in files
    package, installed = tmp_path / "package", tmp_path / "installed"
    for name, content in files.items():
        (package / name).parent.mkdir(parents=True, exist_ok=True)
        (package / name).write_text(content)
    if "pyproject.toml" in files:
        assert "pip install ." in text
        pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index",
               "--no-build-isolation", "--target", str(installed), "."]  # fmt: skip
        done = run(pip, package, installed)
        assert done.returncode == 0, done.stderr
        for module in installed.glob("*.py"):
            (package / module.name).unlink()  # only the installed package can be found
    for program in sorted(package.glob("try_*.py")):
        done = run([sys.executable, program.name], package, installed)
        assert done.returncode == 0, done.stderr[-3000:]
