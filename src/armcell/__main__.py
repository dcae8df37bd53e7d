"""`armcell` and `python -m armcell`: Ctrl-C works from the very first moment on."""

from __future__ import annotations

import signal
import sys

from armcell._interrupts import end, interrupted


def main() -> None:
    """The command line; ends the process with its status."""
    signal.signal(signal.SIGINT, interrupted)
    try:
        from armcell.cli.main import main as run

        code = run(sys.argv[1:])
    except KeyboardInterrupt:
        code = 130
    if code == 130:
        end()
    sys.exit(code)


if __name__ == "__main__":
    main()
