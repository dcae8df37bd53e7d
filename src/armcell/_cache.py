"""Where compiled kernels are kept between runs.

Numba does not notice that a function which a cached one has inlined was changed, and would run the old
machine code. So the cache folder's name is a hash of every source that holds compiled code and of the
versions: changed sources never meet an old entry.
"""

from __future__ import annotations

import hashlib
import os
import platform
import re
import shutil
import sys
import tempfile
import time
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

KEPT_DAYS = 30
COMPILES = re.compile(rb"^\s*(from|import)\s+numba\b|@(numba\.)?njit", re.MULTILINE)
"""Of sources that hold compiled code; a file that only speaks of numba may change without compiling anew."""


def cache_root() -> Path:
    """`ARMCELL_CACHE_DIR`, or `armcell` in the user's cache folder."""
    if chosen := os.environ.get("ARMCELL_CACHE_DIR"):
        return Path(chosen)
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "armcell"


def source_hash() -> str:
    """Of all sources with compiled functions, Python, Numba and the processor."""
    digest = hashlib.sha256()
    for file in sorted(Path(__file__).parent.rglob("*.py")):
        source = file.read_bytes()
        if COMPILES.search(source):
            digest.update(source)
    for package in ("numba", "llvmlite", "numpy"):
        try:
            digest.update(version(package).encode())
        except PackageNotFoundError:
            digest.update(b"none")
    digest.update(f"{sys.version}{platform.machine()}{platform.processor()}".encode())
    return digest.hexdigest()[:16]


def writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _drop_old(used: Path) -> None:
    """Delete kernels of other sources that no process has started with for `KEPT_DAYS`."""
    try:
        if time.time() - used.stat().st_mtime < 86400 and any(used.iterdir()):
            return  # looked at today
        os.utime(used)
        for other in used.parent.iterdir():
            if other != used and time.time() - other.stat().st_mtime > KEPT_DAYS * 86400:
                shutil.rmtree(other, ignore_errors=True)
    except OSError:
        pass  # another process was quicker, or they are not ours to delete


def use_cache() -> Path:
    """Point Numba at the folder for these sources; a temporary one where the user's is not writable."""
    folder = cache_root() / "kernels" / source_hash()
    if not writable(folder):
        folder = (
            Path(tempfile.gettempdir())
            / f"armcell-{os.getuid() if hasattr(os, 'getuid') else 0}"
            / folder.name
        )
        writable(folder)
    _drop_old(folder)
    os.environ["NUMBA_CACHE_DIR"] = str(folder)
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_DIR = str(folder)
    return folder
