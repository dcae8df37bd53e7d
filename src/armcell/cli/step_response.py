"""`armcell step-response`: how a cell's arms follow a jump of their targets, with a plot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import typer
from rich.table import Table

from armcell.cli import goals
from armcell.cli.console import check_writable, console, write_json


def step_response(
    cell: str = goals.CELL,
    gains: str | None = typer.Option(
        None,
        metavar="NAME|FILE",
        help="Gains: a YAML file, or firm, position, tutorial. The cell's own by default.",
    ),
    group: str | None = goals.GROUP,
    size_deg: float = typer.Option(5.0, "--size-deg", min=0.01, max=60, help="Of the step."),
    seconds: float = typer.Option(2.0, min=0.05, max=60, help="How long each joint is watched."),
    plot: Path | None = typer.Option(None, metavar="FILE.png", help="Draw the responses."),
    json_file: Path | None = goals.JSON,
) -> int:
    """Step each joint of a group in physics: rise, overshoot, settling, error, and how far the arm sags.

    Example: armcell step-response dual_ur10 --gains tutorial --plot tutorial.png

    Exit status 0 if every joint settles within 2 % and none sags by more than 1 mrad, 1 if not.
    """
    for file in (plot, json_file):
        if file is not None:
            check_writable(file)
    from armcell.cell import load
    from armcell.sim.step_response import sag, step_responses, with_gains

    loaded = load(cell)
    scene = loaded.scene()
    settings = with_gains(loaded.physics, gains) if gains is not None else loaded.physics
    joints = loaded.model.group(group or goals.arm_group(loaded.model)).joint_names
    fingers = {g.joint_name for g in loaded.model.grippers.values()}
    joints = tuple(j for j in joints if j not in fingers)
    sagged = sag(scene, settings)
    found = step_responses(scene, joints, settings, float(np.deg2rad(size_deg)), seconds)
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("joint")
    for title in ("rise", "overshoot", "settled", "error at the end", "sag"):
        table.add_column(title, justify="right")
    for r in found:
        table.add_row(
            r.joint, _seconds(r.rise_time), f"{100 * r.overshoot:.1f} %", _seconds(r.settling_time),
            f"{1000 * r.final_error:.2f} mrad", f"{1000 * sagged[r.joint]:.2f} mrad",
        )  # fmt: skip
    console.print(table)
    if plot is not None:
        from armcell.records.plots import response_plot

        curves = {r.joint: np.degrees(np.sign(r.size) * r.positions) for r in found}
        title = f"{loaded.name}, {settings.arm_control}: kp {settings.arm_kp:g}, ki {settings.arm_ki:g}, "
        plot.write_bytes(response_plot(found[0].times, curves, size_deg, f"{title}kv {settings.arm_kv:g}"))
        console.print(f"plot: {plot}")
    good = all(np.isfinite(r.settling_time) and sagged[r.joint] <= 1e-3 for r in found)
    if json_file is not None:
        write_json(json_file, {r.joint: _numbers(r, sagged[r.joint]) for r in found})
    return 0 if good else 1


def _seconds(value: float) -> str:
    return f"{value:.3f} s" if np.isfinite(value) else "never"


def _numbers(r, sagged: float) -> dict[str, float | None]:
    finite = lambda v: float(v) if np.isfinite(v) else None  # noqa: E731
    return {
        "rise_time_s": finite(r.rise_time),
        "overshoot": r.overshoot,
        "settling_time_s": finite(r.settling_time),
        "final_error": r.final_error,
        "sag": sagged,
    }
