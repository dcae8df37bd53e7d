"""Saying so before a planner is compiled: that of one that is not used by default comes at its first use."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

from numba import config

logger = logging.getLogger(__name__)


def announce(planner: str, function: Any) -> None:
    """Log that a function (a Numba dispatcher) will now be compiled, unless it is ready or cached."""
    if function.signatures or _cached(function):
        return
    logger.info("compiling planner %s, which is kept for later runs", planner)


def _cached(function: Any) -> bool:
    """Whether there is an index file for it in Numba's cache folder."""
    folder, code = Path(vars(config)["CACHE_DIR"]), function.py_func.__code__
    pattern = f"{Path(code.co_filename).stem}.{code.co_name}-{code.co_firstlineno}.*.nbi"
    return any(folder.rglob(pattern))
