"""Disk cache of computed arrays, keyed by a hash of their inputs."""

from __future__ import annotations

import contextlib
import hashlib
import logging
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from armcell._cache import cache_root, make, trusted_file

logger = logging.getLogger(__name__)


def key_of(*parts: NDArray | str) -> str:
    """Return a key under which arrays are stored on disk. It depends only on the content of the given
    values.
    """
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part.encode() if isinstance(part, str) else np.ascontiguousarray(part).tobytes())
        digest.update(b"|")
    return digest.hexdigest()[:32]


def recall(kind: str, key: str) -> dict[str, NDArray] | None:
    """Return arrays that an earlier process stored on disk, or None if there is no readable and trusted file
    for them.

    A file is trusted if only the current user can have written it.
    """
    file = cache_root() / kind / f"{key}.npz"
    if not trusted_file(file):
        return None
    try:
        with np.load(file, allow_pickle=False) as stored:
            return dict(stored)
    except (OSError, ValueError, KeyError, EOFError, BadZipFile):
        return None  # the file is missing or truncated


def keep(kind: str, key: str, **arrays: NDArray) -> None:
    """Store computed arrays on disk, so that later processes can read them. The write is atomic.

    If the folder is not writable, the function logs the error, and the next process computes the arrays
    again.
    """
    file = cache_root() / kind / f"{key}.npz"
    try:
        make(file.parent)
        with tempfile.NamedTemporaryFile(dir=file.parent, suffix=".npz", delete=False) as temporary:
            np.savez(temporary, **arrays)  # type: ignore[arg-type]
        os.replace(temporary.name, file)
    except OSError as error:
        logger.info("cannot keep %s: %s", file, error)


def recall_or_compute(
    kind: str, key: str, compute: Callable[[], Mapping[str, NDArray]]
) -> Mapping[str, NDArray]:
    """Return arrays from the store on disk. If they are missing, compute and store them.

    If several processes or threads need the same arrays, one computes them while the others wait.
    """
    if (stored := recall(kind, key)) is not None:
        return stored
    with _locked(cache_root() / kind / f"{key}.lock"):
        if (stored := recall(kind, key)) is not None:
            return stored
        found = compute()
        keep(kind, key, **found)
    return found


@contextlib.contextmanager
def _locked(file: Path) -> Iterator[None]:
    """Hold an exclusive lock on the file of a stored array. Without a writable folder or without locks
    (Windows), hold no lock.
    """
    try:
        import fcntl

        make(file.parent)
        stream = open(file, "ab")  # noqa: SIM115
    except (ImportError, OSError):
        yield
        return
    with stream:
        with contextlib.suppress(OSError):  # a file system without locks
            fcntl.flock(stream, fcntl.LOCK_EX)
        try:
            yield
        finally:
            with contextlib.suppress(OSError):
                file.unlink()  # who waits for it finds the stored arrays
