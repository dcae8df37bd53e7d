"""docs/adding_a_driver.md, step by step: a package of its own, found by its entry point."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "adding_a_driver.md").read_text(encoding="utf-8")


def block(language: str) -> str:
    """The first code block of the page in a language."""
    found = re.search(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)
    assert found, f"the page has no {language} block"
    return found[1]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A folder as pip leaves it: the page's module, and the entry points of its project table."""
    folder = tmp_path_factory.mktemp("site")
    project = tomllib.loads(block("toml"))["project"]
    (folder / "my_robot.py").write_text(block("python"), encoding="utf-8")
    info = folder / f"my_robot-{project['version']}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n"
    )
    lines = []
    for group, points in project["entry-points"].items():
        lines += [f"[{group}]", *(f"{name} = {value}" for name, value in points.items())]
    (info / "entry_points.txt").write_text("\n".join(lines) + "\n")
    return folder


def python(site: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(site), str(ROOT / "src")])}
    return subprocess.run(
        [sys.executable, *arguments], cwd=ROOT, env=environment, capture_output=True, text=True, timeout=900
    )


@pytest.mark.slow
def test_a_package_s_driver_is_found_by_its_entry_point_and_only_when_asked_for(site):
    code = (
        "import sys\n"
        "from armcell.drivers import drivers\n"
        "drivers['sim']\n"
        "assert 'my_robot' not in sys.modules\n"
        "print(drivers['my_robot'].__module__, sorted(drivers))\n"
    )
    done = python(site, "-c", code)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "my_robot ['fake', 'my_robot', 'real', 'sim']"


@pytest.mark.long
def test_a_package_that_fails_to_load_is_named_and_hides_no_other(site, tmp_path):
    (tmp_path / "broken_robot.py").write_text("import not_there_at_all\n")
    info = tmp_path / "broken_robot-0.1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: broken-robot\nVersion: 0.1\n")
    (info / "entry_points.txt").write_text("[armcell.drivers]\nbroken = broken_robot\n")
    both = os.pathsep.join([str(tmp_path), str(site)])
    done = python(Path(both), "-c", "from armcell.drivers import drivers; drivers['my_robot']")
    assert done.returncode == 0, done.stderr
    assert "broken-robot 0.1" in done.stderr and "not_there_at_all" in done.stderr


@pytest.mark.long
def test_the_page_s_driver_passes_the_contract_of_every_driver(site):
    done = python(site, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-k", "my_robot",
                  "tests/drivers/test_drivers.py", "tests/drivers/test_proxy.py")  # fmt: skip
    assert done.returncode == 0, done.stdout[-3000:]
    passed = re.search(r"(\d+) passed", done.stdout)
    assert passed and int(passed[1]) >= 20, done.stdout[-500:]


@pytest.mark.long
def test_a_cell_runs_in_the_page_s_mode(site):
    done = python(
        site, "-m", "armcell", "run", "panda_pick", "--mode", "my_robot", "--seed", "0", "--headless"
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
