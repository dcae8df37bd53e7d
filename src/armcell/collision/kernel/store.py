"""What is worked out once per machine: arrays on disk, by the hash of what they were made from."""

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
    """A name, the same in every process for the same content."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part.encode() if isinstance(part, str) else np.ascontiguousarray(part).tobytes())
        digest.update(b"|")
    return digest.hexdigest()[:32]


def recall(kind: str, key: str) -> dict[str, NDArray] | None:
    """What was kept, or None where nothing readable is that only this user can have written."""
    file = cache_root() / kind / f"{key}.npz"
    if not trusted_file(file):
        return None
    try:
        with np.load(file, allow_pickle=False) as stored:
            return dict(stored)
    except (OSError, ValueError, KeyError, EOFError, BadZipFile):
        return None  # not there, or cut off


def keep(kind: str, key: str, **arrays: NDArray) -> None:
    """Write arrays, whole or not at all; a folder that cannot be written only costs the time again."""
    file = cache_root() / kind / f"{key}.npz"
    try:
        make(file.parent)
        with tempfile.NamedTemporaryFile(dir=file.parent, suffix=".npz", delete=False) as temporary:
            np.savez(temporary, **arrays)  # type: ignore[arg-type]
        os.replace(temporary.name, file)
    except OSError as error:
        logger.info("cannot keep %s: %s", file, error)
