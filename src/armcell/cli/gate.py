"""`armcell gate`: issue the gate record that mode `real` requires, and check it before a run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from armcell.cli.console import check_writable, console, err, errors
from armcell.core import InputError

EXAMPLES = """
Examples:

  armcell gate my_cell.yaml --trials 100                     a campaign, and the record if it shows 95 %

  armcell gate my_cell.yaml --campaign runs/20261122-101500-campaign-my_cell    from one that was run

  armcell run my_cell.yaml --mode real                       asks for it
"""
WITHOUT_GATE = typer.Option(
    None, metavar="REASON", help="For mode real, where clients lead the arms; the reason is recorded."
)


def gate(
    cell: str = typer.Argument(..., help="Folder or YAML file of a cell with its task; or a built-in cell."),
    campaign: Path | None = typer.Option(
        None, metavar="FOLDER", help="A campaign of this very cell; without it one is run."
    ),
    trials: int = typer.Option(
        100, min=1, help="Of the campaign that is run; 72 without a failure show 95 %."
    ),
    workers: int = typer.Option(0, min=0, help="Processes; 0: one per core."),
    seed: int = typer.Option(0, min=0, help="Of the first trial; each next one has the next."),
    set_: list[str] = typer.Option(
        [], "--set", metavar="PATH=VALUE", help="Another value than in the cell file; may be repeated."
    ),
    file: Path | None = typer.Option(
        None, "-o", "--output", metavar="FILE", help="The record. [default: <cell>.gate.json beside the cell]"
    ),
    runs: Path = typer.Option(Path("runs"), metavar="FOLDER", help="Where the campaign's folder goes."),
    allow_unvaried: str | None = typer.Option(
        None,
        metavar="REASON",
        help="Accept a campaign whose trials are all the same; the record keeps the reason, and runs with "
        "real arms print it.",
    ),
) -> int:
    """Approve a cell for real arms: write the signed record (gate record) that `armcell run --mode real`
    requires.

    A campaign must show that the task succeeds in at least 95 % of trials in physics, at the lower end of the
    exact 95 % interval, and must have varied a value: 'randomize' or 'drop' of the cell, or parameters.
    The record is valid for this cell, task, settings and versions; any change makes it invalid.
    Exit status 0 if the record was issued, 1 if the campaign does not prove enough.
    """
    from armcell import campaigns
    from armcell.campaigns import gate as gates
    from armcell.campaigns.store import stored_spec
    from armcell.cell import load, parse_value, with_values
    from armcell.cli.campaign import run_campaign

    values = dict(parse_value(one) for one in set_)
    if campaign is not None:
        values = {**stored_spec(campaign)[0].values, **values}
    loaded = with_values(load(cell), values)
    target = file or gates.gate_file(loaded)
    check_writable(target)
    gates.check_reason(allow_unvaried)
    if campaign is None:
        if allow_unvaried is None:
            gates.check_draws(loaded)  # check before the campaign, which takes minutes
        spec = campaigns.CampaignSpec(cell, values=values, trials=trials, seed=seed)
        store = campaigns.begin(spec, runs)
        run_campaign(store, workers)
        campaign = store.folder
    record = gates.issue(loaded, campaign, target, allow_unvaried=allow_unvaried)
    shown = record["campaign"]
    console.print(
        f"{shown['succeeded']} of {shown['trials']} succeeded: at least {shown['interval'][0]:.1%} "
        f"(exact 95 % interval), {shown['unwanted_contacts']} unwanted contacts"
    )
    if record["allow_unvaried"] is not None:
        console.print(
            f"nothing was varied; allowed: {record['allow_unvaried']}", markup=False, soft_wrap=True
        )
    else:
        console.print(f"varied: {', '.join(shown['varied'])}", markup=False, soft_wrap=True)
    console.print(f"gate record: {target}", soft_wrap=True)
    return 0


def check_gate(cell: Any, mode: str, file: Path | None, without: str | None) -> dict[str, Any]:
    """Check that a cell has a valid gate record (signed approval) before a command moves real arms. Return
    the result under the key `gate`, for the record of the run.

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
    """Check that the user gave a reason for moving real arms without a gate record (signed approval). Return
    the reason under the key `gate`, for the record of the run.

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
    """Print a warning, after the gate check of a command, if its real arms are not compared with a simulated
    twin.
    """
    if driver.guard is not None and not driver.guard.compares:
        from armcell.twin import UNWATCHED

        errors.print(f"{UNWATCHED}; hint: armcell twin {cell}", soft_wrap=True)
