"""One session for a module's tests: a Panda that follows exactly, twenty times as fast as the clock."""

from __future__ import annotations

import pytest

from armcell.cell import load
from armcell.moveit import Session
from armcell.moveit.install import installed


@pytest.fixture(scope="module")
def session():
    live = load("panda_table").connect("fake", None, time_scale=20.0)
    with Session(live, quiet=True) as opened, installed(opened.messages):
        yield opened
