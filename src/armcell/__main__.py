"""`armcell` and `python -m armcell`: Ctrl-C works from the very first moment on."""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading
from types import FrameType

GRACE = 1.5  # [s] for an orderly end; compiled code may swallow a KeyboardInterrupt


def _end() -> None:
    """Say it and end: not through libraries' exit handlers, which may wait."""
    sys.stderr.write("armcell: interrupted\n")
    sys.stderr.flush()
    os._exit(130)


def _interrupted(signum: int, frame: FrameType | None) -> None:
    if _importing(frame):  # libraries that try an import swallow whatever comes out of it
        _end()
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)  # it logs the interrupts that it swallows
    timer = threading.Timer(GRACE, _end)
    timer.daemon = True
    timer.start()
    raise KeyboardInterrupt


def _importing(frame: FrameType | None) -> bool:
    """Whether an import statement is among what is being executed."""
    while frame is not None:
        if frame.f_code.co_filename == "<frozen importlib._bootstrap>":
            return True
        frame = frame.f_back
    return False


def main() -> None:
    """The command line; ends the process with its status."""
    signal.signal(signal.SIGINT, _interrupted)
    try:
        from armcell.cli.main import main as run

        code = run(sys.argv[1:])
    except KeyboardInterrupt:
        code = 130
    if code == 130:
        _end()
    sys.exit(code)


if __name__ == "__main__":
    main()
