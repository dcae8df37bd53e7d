"""Each item of the documents in docs/checklist.md names tests and files that exist."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "checklist.md").read_text(encoding="utf-8")
ITEM = re.compile(r"^\| ((?:UM|PP|DU)\d+) \| (.+) \| (.+) \| (\w+) \|$", re.MULTILINE)


def test_the_items_name_files_that_exist():
    items = ITEM.findall(PAGE)
    assert len(items) > 120
    repeated = [name for name, count in Counter(i[0] for i in items).items() if count > 1]
    assert not repeated
    for name, _, where, status in items:
        assert status in ("done", "part", "no"), name
        files = re.findall(r"(?:tests|docs)/[\w/]+(?:\.py|\.md)?", where)
        missing = [f for f in files if not (ROOT / f).exists()]
        assert not missing, f"{name}: {missing}"
        if status == "done":
            assert files or "make test" in where or "examples/" in where, f"{name} names no test"
