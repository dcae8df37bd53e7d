"""Arrays that several processes need at the same time are computed once."""

from __future__ import annotations

import subprocess
import sys

PROGRAM = """
import sys, time
from pathlib import Path
import numpy as np
from armcell._array_store import recall_or_compute

def compute():
    with open(sys.argv[1], "a") as log:
        log.write("computed ")
    time.sleep(0.5)
    return {"x": np.arange(3.0)}

print(recall_or_compute("covers", "0" * 32, compute)["x"].tolist())
"""


def test_one_process_computes_while_the_others_wait(tmp_path, monkeypatch):
    monkeypatch.setenv("ARMCELL_CACHE_DIR", str(tmp_path / "cache"))
    log = tmp_path / "log"
    call = [sys.executable, "-c", PROGRAM, str(log)]
    processes = [subprocess.Popen(call, stdout=subprocess.PIPE, text=True) for _ in range(3)]
    assert [p.communicate(timeout=60)[0] for p in processes] == ["[0.0, 1.0, 2.0]\n"] * 3
    assert log.read_text() == "computed "
    assert not list((tmp_path / "cache" / "covers").glob("*.lock"))
