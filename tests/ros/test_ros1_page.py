"""The Python block of docs/ros1.md runs, and the options it names exist."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

import pytest
from tests import programs

import armcell
from armcell.ros.ros1 import settings, sockets, subscription, xmlrpc
from armcell.ros.ros1.sockets import MAX_CONNECTIONS

PAGE = Path(__file__).parents[2] / "docs" / "ros1.md"


@pytest.mark.slow
def test_the_block_runs(tmp_path):
    (block,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(), flags=re.S)
    done = programs.run(
        [sys.executable, "-c", block], cwd=tmp_path, capture_output=True, text=True, timeout=60,
        env={**os.environ, "PYTHONPATH": str(Path(armcell.__file__).parents[1])},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


def test_the_numbers_are_those_in_the_code():
    text = PAGE.read_text()
    bare = settings.Ros1Settings()
    for value in (
        f"{bare.max_message >> 20} MiB a message", f"{sockets.MAX_HEADER >> 20} MiB a header",
        f"{xmlrpc.MAX_BODY >> 20} MiB an XML-RPC call", f"{MAX_CONNECTIONS} connections",
        f"{bare.queue} messages or {bare.queue_bytes >> 20} MiB", f"after {subscription.FIRST_RETRY:g} s",
        f"every {subscription.LAST_RETRY:g} s", settings.MASTER,
    ):  # fmt: skip
        assert value in text, value
