"""The gate check of `armcell run --mode real`, and its entry in the record of the run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from armcell.cli.console import err, errors
from armcell.core import InputError

WITHOUT_GATE = typer.Option(
    None, metavar="REASON", help="For mode real, where clients lead the arms; the reason is recorded."
)


def check_gate(cell: Any, mode: str, file: Path | None, without: str | None) -> dict[str, Any]:
    """Check, before a command moves real arms, that the cell has a valid signed approval (gate record).
    Return {"gate": entry} for the record of the run.

    In other modes, return an empty dict.

    Args:
        file: the gate record; None for the default file.
        without: reason to run without a gate record.
    Raises:
        InputError: the cell has no valid gate record, and no reason to run without it was given.
    """
    if mode != "real" or not cell.spec.real:  # without configured arms, the driver reports the error
        return {}
    from armcell.campaigns import gate

    if without is not None:
        if not without.strip():
            raise InputError(
                "--without-gate needs a reason", hint='--without-gate "first trial, arm in the air"'
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


def require_gate_override(mode: str, what: str, without: str | None) -> dict[str, Any]:
    """Require the user's reason to move real arms without a signed approval (gate record). Return {"gate":
    entry} for the record of the run.

    Motions that clients request, for example, have no gate record, because no campaign can test them.
    In modes other than real, return an empty dict.

    Args:
        what: the motions, in words.
        without: reason to run without a gate record.
    Raises:
        InputError: no reason to run without a gate record was given.
    """
    if mode != "real":
        return {}
    if not (without or "").strip():
        raise InputError(
            f"no campaign can show {what}: there is no gate record for that",
            hint='--without-gate "REASON"; a cell\'s own task has one: armcell gate',
        )
    err(f"without a gate record: {without}")
    return {"gate": {"overridden": True, "reason": without, "else": f"no campaign can show {what}"}}


def gate_summary(passed: dict[str, Any]) -> str:
    found = passed["gate"]
    if found["overridden"]:
        return f"gate overridden: {found['reason']}"
    shown = found["campaign"]
    unvaried = found.get("allow_unvaried")  # missing in records of older runs
    note = "" if unvaried is None else f"; the campaign varied nothing: {unvaried}"
    return (
        f"gate passed: {shown['succeeded']} of {shown['trials']} in simulation, "
        f"at least {shown['interval'][0]:.1%}; {found['file']}{note}"
    )


def warn_without_twin(driver: Any, cell: str) -> None:
    """Print a warning if a command moves real arms that are not compared with a simulated twin."""
    if driver.guard is not None and not driver.guard.compares:
        from armcell.twin import UNWATCHED

        errors.print(f"{UNWATCHED}; hint: armcell twin {cell}", soft_wrap=True)
