"""Workers of campaigns that tests run in their own process are forked: see tests/programs.py."""

from __future__ import annotations

import subprocess
from types import SimpleNamespace

import pytest
from tests.programs import Program

from armcell.campaigns import pool


@pytest.fixture(autouse=True)
def _forked_workers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool, "subprocess", SimpleNamespace(Popen=Program, PIPE=subprocess.PIPE))
