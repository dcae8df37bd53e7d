"""Prevention of garbage collections during imports and in programs that must keep time."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def gc_frozen() -> Iterator[None]:
    """Prevent long pauses in a `with` block: garbage collection ignores all objects that exist on entry.

    A full collection pauses all threads: 0.14 s for 200,000 objects (a cell with compiled code), more than a
    second for 700,000. One collection runs on entry.
    Source: https://docs.python.org/3/library/gc.html#gc.freeze
    """
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


@contextmanager
def gc_paused() -> Iterator[None]:
    """Prevent garbage collections in a `with` block that creates many long-lived objects, such as an import.

    With Python's thresholds, the collections take a fifth of the CPU time of `from armcell.cell import load`.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
