"""The habits that CONTRIBUTING.md states are checked: commit subjects, files that pages name."""

import importlib.util
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
spec = importlib.util.spec_from_file_location("commit_subject", ROOT / ".ci/commit_subject.py")
assert spec is not None and spec.loader is not None
commit_subject = importlib.util.module_from_spec(spec)
spec.loader.exec_module(commit_subject)


@pytest.mark.parametrize(
    "subject",
    ["collision: report the depth of each pair", "ros, cli: print the address", "Merge branch 'x'"],
)
def test_good_subjects_pass(subject):
    assert commit_subject.fault(subject) is None


@pytest.mark.parametrize(
    ("subject", "reason"),
    [
        ("collision: " + "x" * 70, "limit is 72"),
        ("Report the depth", "area"),
        ("colision: report the depth", "is not an area"),
        ("collision: report the depth.", "period"),
    ],
)
def test_bad_subjects_are_refused(subject, reason):
    assert reason in commit_subject.fault(subject)


@pytest.mark.parametrize(
    "page", ["docs/design.md", "docs/checklist.md", "docs/tasks.md", "docs/grasping.md", "CONTRIBUTING.md"]
)
def test_pages_name_files_that_exist(page):
    named = re.findall(
        r"`((?:src|tests|docs|benchmarks|[a-z_0-9]+)/[\w./]+\.(?:py|md))`", (ROOT / page).read_text()
    )
    missing = [
        name for name in named if not ((ROOT / name).exists() or (ROOT / "src/armcell" / name).exists())
    ]
    assert not missing
