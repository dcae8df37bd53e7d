"""`armcell emulate`: emulated controllers for a cell's real arms; execution of any vendor's emulators."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

import typer

from armcell.cli.console import console, print_addresses
from armcell.core.gc_pauses import gc_frozen

EXAMPLES = """
Examples:

  armcell emulate panda_ur10e_handover --seed 1     a Panda's and a UR10e's controller in one physics world

  armcell run panda_ur10e_handover --mode real --seed 1 --without-gate "emulator"    in another terminal
"""


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


def emulate(
    cell: str = typer.Argument(..., help="A cell file with a block `real`, its folder, or a built-in cell."),
    seed: int | None = typer.Option(None, min=0, help="Seed of the cell's randomized values."),
    set_: list[str] = typer.Option(
        [], "--set", metavar="PATH=VALUE", help="Another value than in the cell file; may be repeated."
    ),
    trace: Path | None = typer.Option(
        None, metavar="FILE", help="Write every control step: index of the arm, then its vendor's record."
    ),
    reset_between_runs: bool = typer.Option(
        False,
        "--reset-between-runs",
        help="Put arms and objects back to their start once all clients have left for 1 s.",
    ),
) -> int:
    """Emulate the controllers of all real arms of a cell until Ctrl-C, in one physics world.

    Kind, address and model of each arm come from the cell's block `real`. Runs with real-time priority if
    permitted (as root on Linux).
    """
    from armcell.cell import load, parse_value, with_values
    from armcell.drivers.real import real_settings
    from armcell.emulators import cell_rack

    loaded = with_values(load(cell), dict(parse_value(one) for one in set_))
    settings = real_settings(loaded.spec.real, loaded.model)

    def say(text: str) -> None:
        console.print(text, soft_wrap=True, markup=False, highlight=False)

    file = trace.open("wb", buffering=0) if trace is not None else None
    rack = cell_rack(settings, loaded.scene(seed), loaded.physics, say, file, reset_between_runs)
    rack.open()
    for (name, arm), controller in zip(settings.arms.items(), rack.controllers, strict=True):
        say(f"{name}: {arm.kind} at {arm.host}")
        print_addresses(controller.network.endpoints)
    run_emulator(rack, file)
    return 0
