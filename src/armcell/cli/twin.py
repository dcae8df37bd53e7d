"""`armcell twin`: learn the normal deviation between real arms and their simulated twin."""

from __future__ import annotations

import numpy as np
import typer

from armcell.cli.console import check_writable, console


def twin(
    cell: str = typer.Argument(..., help="Folder or YAML file of a cell with a block 'real'."),
    motions: int = typer.Option(12, min=3, help="Of each arm, after the slow loop that comes first."),
    seed: int = typer.Option(0, min=0, help="Of the motions' goals."),
    yes: bool = typer.Option(False, "--yes", help="Do not ask. For emulators."),
) -> int:
    """Move the real arms, and learn how much they normally deviate from their simulated twin.

    The command starts with a slow loop. Run it after every change of model, gains or calibration.
    It writes <cell>.twin.json beside the cell file; from then on, mode real slows and stops an arm that
    leaves its thresholds.
    """
    from armcell.cell import load
    from armcell.cell.twin import thresholds_file
    from armcell.cell.twin_learning import learn_thresholds
    from armcell.core import InputError
    from armcell.drivers.real import kind_of, real_settings
    from armcell.planning import warm_up

    loaded = load(cell)
    target = thresholds_file(loaded)
    check_writable(target)
    hosts = [str(arm.get("host", "")) for arm in loaded.spec.real.get("arms", {}).values()]
    if yes and not all(h.startswith("127.") for h in hosts):
        raise InputError("--yes is for emulators on this machine (127.x), these arms may be real",
                         hint="leave it out and confirm")  # fmt: skip
    if hosts and not yes:
        typer.confirm(
            f"Arms at {', '.join(hosts)} will move about their home position, at first at 10 %, then up to "
            "60 % of their speed. Hand on the emergency stop. Go on?", abort=True,
        )  # fmt: skip
    warm_up()
    bands = learn_thresholds(loaded, motions, seed, console.print)
    bands.save(target)
    settings = real_settings(loaded.spec.real, loaded.model)
    for name, arm in bands.arms.items():
        effort, unit = kind_of(settings.arms[name]).effort
        measured = np.isfinite(arm.current).all()
        console.print(
            f"{name}: position {np.rad2deg(arm.position.max()):.2f} deg, "
            f"velocity {arm.velocity.max():.2f} rad/s, "
            + (
                f"{effort} {arm.current.max():.2f} {unit}, load {arm.load:.1f} kg, "
                if measured
                else f"no {effort} measured, "
            )
            + f"round trip {arm.trip * 1000:.0f} ms; {arm.lag * 1000:.0f} ms behind; {arm.samples} looks",
            soft_wrap=True,
        )
    console.print(f"bands: {target}", soft_wrap=True)
    return 0
