"""`armcell bringup`: guided bring-up of real arms, from network test to first motions."""

from __future__ import annotations

import sys
from pathlib import Path

import typer

from armcell.cli.console import check_writable, console
from armcell.core import InputError


def bringup(
    cell: str = typer.Argument(..., help="Cell whose file has a block 'real' with the arms' addresses."),
    yes: bool = typer.Option(False, "--yes", help="Confirm every step at once. For emulators only."),
    record: Path = typer.Option(
        Path("bringup.json"), metavar="FILE", help="Where every step is written down."
    ),
) -> int:
    """Bring up the real arms of a cell step by step.
    Each step is explained and must be confirmed before it is executed.

    Network, identity, power, geometry; then, at 5 % speed: single joints, a 10 cm line compared with its
    preview while the other arms stand still, and all arms together. Set the pendant's speed slider to 10 %
    first, and keep a hand on the emergency stop. armcell is not a safety system.
    """
    check_writable(record)
    if not yes and not sys.stdin.isatty():
        raise InputError("bring-up asks before each step, but standard input is not a terminal",
                         hint="run it in a terminal (or --yes against emulators)")  # fmt: skip
    from armcell.cell.bringup import BringUp
    from armcell.cell.health import first_layers

    def confirm(name: str, text: str) -> bool:
        console.print(f"[bold]{name}[/bold]: {text}", highlight=False)
        return yes or typer.confirm("  go on?", default=False)

    def tell(text: str) -> None:
        console.print(f"  {text}", markup=False, highlight=False)

    loaded, _ = first_layers(cell, "real", lambda text: console.print(text, markup=False, highlight=False))
    hosts = [str(arm.get("host", "")) for arm in loaded.spec.real.get("arms", {}).values()]
    if yes and not all(h.startswith("127.") for h in hosts):
        raise InputError("--yes is for emulators on this machine (127.x), these arms may be real",
                         hint="leave it out and confirm each step")  # fmt: skip
    done = BringUp(loaded, confirm, tell, record).run()
    console.print(
        "bring-up complete" if done else "[red]bring-up ended early[/red]; nothing goes on by itself"
    )
    console.print(f"record: {record}", soft_wrap=True)
    return 0 if done else 1
