"""Folders in which compiled kernels and computed arrays are cached between runs.

Numba's cache files are pickles and machine code: loading them executes code, and a manipulated array makes
collision checks wrong. Therefore armcell reads cache files only from a folder that no other user can write,
judged by its owner and mode.

Numba does not notice when a function is changed that a cached function has inlined, and would run the old
machine code. The name of the cache folder is therefore a hash of the versions and of every source file that
contains compiled code, so changed sources never use an old cache entry.
"""

from __future__ import annotations

import atexit
import hashlib
import logging
import os
import re
import shutil
import stat
import sys
import sysconfig
import tempfile
import time
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.util import MAGIC_NUMBER
from pathlib import Path

from armcell._kernel_pack import matching_pack, use_pack

KEPT_DAYS = 30
COMPILES = re.compile(rb"^\s*(from|import)\s+numba\b|@(numba\.)?(inner_)?njit", re.MULTILINE)
"""Matches sources with compiled code; changes of files that only mention numba do not cause recompilation."""


log = logging.getLogger("armcell")


def chosen_root() -> Path:
    """Return the configured folder of armcell's kernel cache. The function does not check that the folder is
    trusted.

    The folder is `ARMCELL_CACHE_DIR`, or `armcell` in the user's cache folder.
    """
    if chosen := os.environ.get("ARMCELL_CACHE_DIR"):
        return Path(chosen)
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "armcell"


def cache_root() -> Path:
    """Return the root folder of armcell's caches: the configured folder if it is safe, otherwise a private
    one.

    The configured folder is unsafe if other users can write there.
    """
    return _trusted_root(chosen_root())


@cache
def _trusted_root(chosen: Path) -> Path:
    if not writable(chosen) and not os.path.isdir(chosen):
        return chosen  # nothing is cached
    reason = doubt(chosen)
    if reason is None:
        return chosen.resolve()
    _say_unused(chosen, reason, private_folder())
    return private_folder()


@cache
def private_folder() -> Path:
    """Return a temporary cache folder that only this user can write to. Later runs use the same folder if
    possible.
    """
    folder = Path(tempfile.gettempdir()) / f"armcell-{_user()}"
    if writable(folder) and doubt(folder) is None:
        return folder.resolve()
    made, maker = Path(tempfile.mkdtemp(prefix="armcell-")), os.getpid()  # mode 700
    atexit.register(lambda: os.getpid() == maker and shutil.rmtree(made, ignore_errors=True))
    return made.resolve()


def _say_unused(folder: Path, reason: str, instead: Path) -> None:
    log.warning(
        "armcell: the cache %s is not used, because %s; %s is used instead. Hint: let only your user write "
        "there (chmod go-w), or set ARMCELL_CACHE_DIR to another folder",
        folder, reason, instead,
    )  # fmt: skip


def _user() -> int:
    return os.geteuid() if hasattr(os, "geteuid") else 0


def doubt(folder: Path, contents: bool = False) -> str | None:
    """Return the reason why another user may have written into a cache folder, or None if the folder is safe.

    Links are resolved first. The folder and all its parents must belong to this user or root, and no other
    user may have write access; for the parents, the sticky bit (as on /tmp) is sufficient.

    Args:
        contents: also check every file and folder inside: no links, and the same owner and mode.
    """
    if not hasattr(os, "geteuid"):
        return None  # Windows: the user's folders are private
    real = folder.resolve()
    try:
        for place in (real, *real.parents):
            status = place.lstat()
            sticky = place != real and status.st_mode & stat.S_ISVTX
            if found := _doubt_of(place, status, 0 if sticky else 0o022):
                return found
        if contents:
            return _doubt_inside(str(real))
    except OSError as error:
        return f"{real} cannot be examined ({error.strerror})"
    return None


def _doubt_inside(folder: str) -> str | None:
    hidden = not os.lstat(folder).st_mode & 0o077
    forbidden = 0o002 if hidden else 0o022  # with umask 002 Numba's files are writable by the group
    for entry in os.scandir(folder):  # thousands of entries: creating a Path for each is slow
        try:
            status = entry.stat(follow_symlinks=False)
        except FileNotFoundError:
            continue  # another process has renamed or deleted it
        if not (stat.S_ISREG(status.st_mode) or stat.S_ISDIR(status.st_mode)):
            return f"{entry.path} is not a regular file"
        found = _doubt_of(entry.path, status, forbidden)
        if found is None and stat.S_ISDIR(status.st_mode):
            found = _doubt_inside(entry.path)
        if found is not None:
            return found
    return None


def _doubt_of(path: Path | str, status: os.stat_result, forbidden: int) -> str | None:
    if status.st_uid not in (_user(), 0):
        return f"{path} belongs to another user (uid {status.st_uid})"
    if status.st_mode & forbidden:
        return f"other users can write {path} (mode {stat.S_IMODE(status.st_mode):o})"
    return None


def trusted_file(file: Path) -> bool:
    """Return whether a cache file can be trusted: only this user can write to the file and its folder.

    A missing file is not trusted.
    """
    try:
        status, around = file.lstat(), file.parent.lstat()
    except OSError:
        return False
    if not hasattr(os, "geteuid"):
        return True
    return (
        stat.S_ISREG(status.st_mode)
        and stat.S_ISDIR(around.st_mode)
        and _doubt_of(file, status, 0o022) is None
        and _doubt_of(file.parent, around, 0o022) is None
    )


def source_hash() -> str:
    """Return a hash that identifies a version of the kernel cache: it covers Python's bytecode, the platform,
    Numba, and all sources with compiled code. Numba's cache itself tells processors apart.
    """
    digest = hashlib.sha256()
    folders = os.walk(os.path.dirname(__file__))  # a third of the time of Path.rglob
    files = (os.path.join(folder, name) for folder, _, names in folders for name in names)
    for file in sorted((file for file in files if file.endswith(".py")), key=lambda file: file.split(os.sep)):
        with open(file, "rb", buffering=0) as stream:
            source = stream.read()
        if (b"numba" in source or b"njit" in source) and COMPILES.search(source):
            digest.update(source)
    for package in ("numba", "llvmlite", "numpy"):
        try:
            digest.update(version(package).encode())
        except PackageNotFoundError:
            digest.update(b"none")
    python = f"{sys.implementation.cache_tag} {MAGIC_NUMBER.hex()} {sysconfig.get_platform()}"
    digest.update(python.encode())
    return digest.hexdigest()[:16]


def writable(folder: Path) -> bool:
    """Return whether files can be created in a cache folder. If the folder does not exist, create it.

    Only this user has access to a created folder.
    """
    try:
        make(folder)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def make(folder: Path) -> None:
    """Create a cache folder and its missing parent folders; only this user has access to them."""
    if not os.path.isdir(folder):
        make(folder.parent)
        folder.mkdir(mode=0o700, exist_ok=True)


def _drop_old(used: Path) -> None:
    """Delete cached kernels that belong to other versions of the sources and that no process has used for
    `KEPT_DAYS`.
    """
    try:
        if time.time() - used.stat().st_mtime < 86400 and any(used.iterdir()):
            return  # already checked today
        os.utime(used)
        for other in used.parent.iterdir():
            if other != used and time.time() - other.stat().st_mtime > KEPT_DAYS * 86400:
                shutil.rmtree(other, ignore_errors=True)
    except OSError:
        pass  # another process deleted them first, or they belong to another user


def use_cache() -> Path:
    """Select the folder in which Numba caches kernels compiled from the current sources, and return this
    folder. If armcell ships a kernel pack for the current sources and this processor, the folder contains it.

    `NUMBA_CACHE_DIR` has priority. If another user may have written into the folder, a private folder is used
    instead, and a warning is logged.
    """
    given, current = os.environ.get("NUMBA_CACHE_DIR"), source_hash()
    folder = Path(given) if given else cache_root() / "kernels" / current
    reason = doubt(folder, contents=True) if writable(folder) else ""
    if reason is not None:
        if reason:
            _say_unused(folder, reason, private_folder())
        folder = private_folder() / "kernels" / current
        if not writable(folder) or doubt(folder, contents=True) is not None:
            folder = Path(tempfile.mkdtemp(prefix="once-", dir=folder.parent))
    folder = folder.resolve()  # Numba must not follow a link that is changed later
    if not given:
        _drop_old(folder)
    os.environ["NUMBA_CACHE_DIR"] = str(folder)
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_DIR = str(folder)
    if pack := matching_pack(current):
        use_pack(pack, folder)
    return folder
