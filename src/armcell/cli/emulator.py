"""Execution of emulated controllers of any vendor from the command line."""

from __future__ import annotations

import os
from contextlib import suppress
from typing import IO, Any

from armcell.cli.console import console
from armcell.core.gc_pauses import gc_frozen


def run_emulator(rack: Any, trace: IO[bytes] | None) -> None:
    """Run the emulators of controllers (UR, Franka) that a command has created, until a signal ends them.

    Args:
        rack: an `emulators.rack.Rack` whose ports are open.
        trace: file for the record of every control step, or None.
    """
    console.print("an emulator, not a robot; Ctrl-C ends it")
    with suppress(PermissionError, AttributeError):  # a controller must not be late on a busy machine
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(12))
    try:
        with gc_frozen():
            rack.run()
    finally:
        rack.close()
        if trace is not None:
            trace.close()
