"""Calling the command line, in this process or in another."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

from tests.programs import Program

from armcell.cli.main import main

# A cell for quick runs: nothing to plan around, one motion.
NOD = "robot: panda\nstart: {arm: home}\ntask: [{move: extended}]\n"


class Said(NamedTuple):
    status: int
    out: str
    err: str

    @property
    def words(self) -> str:
        """Everything on standard output on one line: tables wrap as the terminal is wide."""
        return " ".join(self.out.split())


def call(capsys, *arguments: object) -> Said:
    """`armcell ARGUMENTS` in this process. Whatever it says, it says without a traceback."""
    status = main([str(a) for a in arguments])
    captured = capsys.readouterr()
    assert "Traceback" not in captured.err
    return Said(status, captured.out, captured.err)


def start(*arguments: object, **options) -> subprocess.Popen:
    """`armcell ARGUMENTS` as a process in a group of its own."""
    return Program(
        [sys.executable, "-m", "armcell", *map(str, arguments)],
        stdin=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
        **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **options},
    )


def finished(process: subprocess.Popen, timeout: float = 60.0) -> Said:
    """The end of a process; none of its group is left (helpers notice within a moment that it is gone)."""
    out, err = process.communicate(timeout=timeout)
    end = time.monotonic() + 2.0
    while time.monotonic() < end:
        try:
            os.killpg(process.pid, 0)
        except ProcessLookupError:
            return Said(process.returncode, out, err)
        time.sleep(0.02)
    raise AssertionError("a process of the group is still there")


def cell_file(folder: Path, text: str = NOD) -> Path:
    file = folder / "cell.yaml"
    file.write_text(text)
    return file


def read_json(file: Path):
    return json.loads(file.read_text(), parse_constant=lambda c: 1 / 0)  # NaN and Infinity are no JSON
