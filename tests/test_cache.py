"""The folder of compiled kernels: old ones go, those in use stay."""

from __future__ import annotations

import os
import time

from armcell import _cache


def test_kernels_nobody_uses_are_deleted(tmp_path, monkeypatch):
    monkeypatch.setenv("ARMCELL_CACHE_DIR", str(tmp_path))
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")  # put back afterwards
    for name, days in (("old", 31), ("recent", 20)):
        (tmp_path / "kernels" / name).mkdir(parents=True)
        then = time.time() - days * 86400
        os.utime(tmp_path / "kernels" / name, (then, then))
    numba_s = __import__("numba").config.CACHE_DIR
    try:
        used = _cache.use_cache()
    finally:
        __import__("numba").config.CACHE_DIR = numba_s
    assert sorted(p.name for p in (tmp_path / "kernels").iterdir()) == sorted([used.name, "recent"])
