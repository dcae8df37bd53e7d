"""`armcell` and `python -m armcell`: Ctrl-C works from the very first moment on."""

from __future__ import annotations

import os
import signal
import sys
import threading
from types import FrameType

GRACE = 1.5  # [s] for an orderly end; compiled code and some imports swallow a KeyboardInterrupt


def _interrupted(signum: int, frame: FrameType | None) -> None:
    timer = threading.Timer(GRACE, os._exit, (130,))
    timer.daemon = True
    timer.start()
    raise KeyboardInterrupt


def main() -> None:
    """The command line; ends the process with its status."""
    signal.signal(signal.SIGINT, _interrupted)
    try:
        from armcell.cli.main import main as run

        code = run(sys.argv[1:])
    except KeyboardInterrupt:
        code = 130
    if code == 130:
        sys.stderr.write("armcell: interrupted\n")
        sys.stderr.flush()
        os._exit(code)  # not through libraries' exit handlers, which may wait
    sys.exit(code)


if __name__ == "__main__":
    main()
