"""What `armcell run --mode real` asks of the gate, and what the run's record keeps of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from armcell.cli.console import err, errors
from armcell.core import InputError

WITHOUT_GATE = typer.Option(
    None, metavar="REASON", help="For mode real, where clients lead the arms; the reason is recorded."
)


def gate_of(cell: Any, mode: str, file: Path | None, without: str | None) -> dict[str, Any]:
    """{"gate": what the run's record keeps} in mode real, else nothing.

    Raises:
        InputError: no record of this cell, and no reason given to go without.
    """
    if mode != "real" or not cell.spec.real:  # without arms the driver says what to write
        return {}
    from armcell.campaigns import gate

    if without is not None:
        if not without.strip():
            raise InputError(
                "--without-gate needs a reason", cure='--without-gate "first trial, arm in the air"'
            )
        try:
            gate.check(cell, file)
            why = "the record would have been valid"
        except InputError as error:
            why = str(error)
        err(f"without a gate record: {without}")
        return {"gate": {"overridden": True, "reason": without, "else": why}}
    record = gate.check(cell, file)
    if record["allow_unvaried"] is not None:
        err(f"the gate record is of a campaign that varied nothing: {record['allow_unvaried']}")
    return {"gate": {"overridden": False, **record}}


def gate_of_others(mode: str, what: str, without: str | None) -> dict[str, Any]:
    """The same for motions that are no cell's task: no campaign has shown them.

    Args:
        what: they are, in words.
    Raises:
        InputError: no reason given to go without a gate record.
    """
    if mode != "real":
        return {}
    if not (without or "").strip():
        raise InputError(
            f"no campaign can show {what}: there is no gate record for that",
            cure='--without-gate "REASON"; a cell\'s own task has one: armcell gate',
        )
    err(f"without a gate record: {without}")
    return {"gate": {"overridden": True, "reason": without, "else": f"no campaign can show {what}"}}


def gate_words(passed: dict[str, Any]) -> str:
    found = passed["gate"]
    if found["overridden"]:
        return f"gate overridden: {found['reason']}"
    shown = found["campaign"]
    unvaried = found.get("allow_unvaried")  # not in records of older runs
    note = "" if unvaried is None else f"; the campaign varied nothing: {unvaried}"
    return (
        f"gate passed: {shown['succeeded']} of {shown['trials']} in simulation, "
        f"at least {shown['interval'][0]:.1%}; {found['file']}{note}"
    )


def tell_unwatched(driver: Any, cell: str) -> None:
    """Say on standard error where real arms move without being compared with their twin."""
    guard = getattr(driver, "guard", None)
    if guard is not None and guard.bands is None:
        from armcell.control.twin import UNWATCHED

        errors.print(f"{UNWATCHED}; cure: armcell twin {cell}", soft_wrap=True)
