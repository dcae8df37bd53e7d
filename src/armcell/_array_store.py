"""Disk cache of computed arrays, keyed by a hash of their inputs."""

from __future__ import annotations

import hashlib
import logging
import os
import tempfile
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from armcell._cache import cache_root, make, trusted_file

logger = logging.getLogger(__name__)


def key_of(*parts: NDArray | str) -> str:
    """Return a cache key that depends only on the content of the given values; arrays are stored on disk
    under this key.
    """
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part.encode() if isinstance(part, str) else np.ascontiguousarray(part).tobytes())
        digest.update(b"|")
    return digest.hexdigest()[:32]


def recall(kind: str, key: str) -> dict[str, NDArray] | None:
    """Return arrays that an earlier process computed and stored in the disk cache, or None if the cache has
    no readable and trusted file for them.

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
    """Write computed arrays to the disk cache, so that later processes can read them. The write is atomic.

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
