"""`armcell view`: what it refuses, in one line. What it does: tests/viewer, test_interrupt.py."""

from __future__ import annotations

import pytest
from tests.cli.helpers import call

WRONG = {
    "no such cell": (("view", "nowhere"), 1, "unknown cell 'nowhere'"),
    "no such mode": (("view", "panda_pick", "--mode", "dream"), 1, "unknown mode 'dream'"),
    "no such port": (("view", "panda_pick", "--port", "70000"), 2, "--port"),
}


@pytest.mark.parametrize(("arguments", "status", "words"), WRONG.values(), ids=WRONG)
def test_wrong_use(capsys, arguments, status, words):
    said = call(capsys, *arguments)
    assert said.status == status and words in said.err
