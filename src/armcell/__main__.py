"""Entry point of `armcell` and `python -m armcell`: handles signals and output errors early."""

from __future__ import annotations

import contextlib
import gc
import sys

from armcell import _interrupts, _streams

COLLECTION = (100_000, 20, 20)
"""Thresholds of the garbage collection. Imports create hundreds of thousands of objects that stay; with
Python's thresholds, collections take a sixth of the CPU time of a start."""


def main() -> None:
    """Run the command line of `python -m armcell`, then end the process with the exit status of the
    command.
    """
    _streams.install()
    _interrupts.install()
    gc.set_threshold(*COLLECTION)
    code = 1
    try:
        try:
            from armcell.cli.main import main as run

            code = run(sys.argv[1:])
        except _interrupts.Interrupted:
            pass
        except SystemExit as over:
            code = over.code if isinstance(over.code, int) else 1
        _interrupts.uninstall()
    except _interrupts.Interrupted:  # interrupted during the last steps
        pass
    if _interrupts.asked():
        with contextlib.suppress(Exception):
            sys.stdout.flush()
        _interrupts.end()
    sys.exit(_streams.close() or code)


if __name__ == "__main__":
    main()
