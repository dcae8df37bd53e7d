"""Lines that other commands measure, each in a process of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

WARM_UP = "from armcell.planning import warm_up; warm_up()"


class Missing(Exception):
    """A command that this version of armcell does not have, or that failed."""


def bench(command: str, *options: str) -> list[dict[str, Any]]:
    """The rows of `armcell bench COMMAND OPTIONS --json ...`.

    Raises:
        Missing: there is no such command, or it wrote nothing.
    """
    call = [sys.executable, "-m", "armcell", "bench", command]
    if subprocess.run([*call, "--help"], capture_output=True).returncode:
        raise Missing(f"`armcell bench {command}` does not exist in this version")
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "rows.json"
        done = subprocess.run([*call, *options, "--json", str(out)], capture_output=True, text=True)
        if not out.exists():
            last = (done.stderr.strip().splitlines() or ["no message"])[-1]
            raise Missing(f"`armcell bench {command} {' '.join(options)}` failed: {last}")
        return json.loads(out.read_text())


def compile_times() -> dict[str, float]:
    """CPU and wall time [s] of a process that gets the planner ready: with an empty cache, and again."""
    result = {}
    with tempfile.TemporaryDirectory() as folder:
        for name in ("first", "later"):
            result[f"{name}_cpu_s"], result[f"{name}_wall_s"] = _process(folder)
    return result


def _process(cache: str) -> tuple[float, float]:
    # This process has pointed Numba at its own cache folder; the child is to choose its own.
    # Bytecode is kept, as on a user's machine, whatever this one's environment says.
    environment = {
        k: v for k, v in os.environ.items() if k not in ("NUMBA_CACHE_DIR", "PYTHONDONTWRITEBYTECODE")
    }
    environment |= {"ARMCELL_CACHE_DIR": cache, "PYTHONPYCACHEPREFIX": f"{cache}/bytecode"}
    began = time.monotonic()
    child = subprocess.Popen([sys.executable, "-c", WARM_UP], env=environment)
    _, status, used = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise Missing(f"getting the planner ready ended with status {child.returncode}")
    return used.ru_utime + used.ru_stime, time.monotonic() - began
