"""Ctrl-C: an orderly end that has a limit. Nothing slow is imported: it works from the first moment on."""

from __future__ import annotations

import logging
import os
import sys
import threading
from types import FrameType

GRACE = 1.5  # [s] for an orderly end; compiled code may swallow a KeyboardInterrupt
WITH_ARMS = 15.0  # [s] until arms rest, and a record and its report are written

_timer: threading.Timer | None = None


def end() -> None:
    """Say it and end: not through libraries' exit handlers, which may wait."""
    sys.stderr.write("armcell: interrupted\n")
    sys.stderr.flush()
    os._exit(130)


def interrupted(signum: int, frame: FrameType | None) -> None:
    """What SIGINT does."""
    if _importing(frame):  # libraries that try an import swallow whatever comes out of it
        end()
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)  # it logs the interrupts that it swallows
    _limit(GRACE)
    raise KeyboardInterrupt


def take_time(seconds: float = WITH_ARMS) -> None:
    """The interrupt has been caught, and the orderly end takes longer; nothing where there was none."""
    if _timer is not None:
        _limit(seconds)


def _limit(seconds: float) -> None:
    global _timer
    if _timer is not None:
        _timer.cancel()
    _timer = threading.Timer(seconds, end)
    _timer.daemon = True
    _timer.start()


def _importing(frame: FrameType | None) -> bool:
    """Whether an import statement is among what is being executed."""
    while frame is not None:
        if frame.f_code.co_filename == "<frozen importlib._bootstrap>":
            return True
        frame = frame.f_back
    return False
