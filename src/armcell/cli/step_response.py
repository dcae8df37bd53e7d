"""`armcell step-response`: measure how a cell's arms follow a step of their targets."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import typer
from rich.table import Table

from armcell.cli import goal_options
from armcell.cli.console import check_writable, console, write_json

EXAMPLES = """
Examples:

  armcell step-response dual_ur10                              every arm joint with the cell's own gains

  armcell step-response dual_ur10 --gains tutorial --plot tutorial.png

  armcell step-response dual_ur10 --gains controllers.yaml     the gains of ros_control's file

  armcell run my_cell.yaml --gains controllers.yaml            the task with these gains; to keep them, write
                                                               physics: {gains: controllers.yaml} in the cell
"""


def step_response(
    cell: str = goal_options.CELL,
    gains: str | None = goal_options.GAINS,
    group: str | None = typer.Option(None, help="Joints of this planning group only; all arms by default."),
    size_deg: float = typer.Option(
        5.0,
        "--size-deg",
        min=0.01,
        max=60,
        help="Size of the step [deg]; for a sliding joint 1 rad is 1 m.",
    ),
    seconds: float = typer.Option(2.0, min=0.05, max=60, help="How long each joint is watched."),
    plot: Path | None = typer.Option(None, metavar="FILE.png", help="Draw a panel per joint."),
    json_file: Path | None = goal_options.JSON,
) -> int:
    """Measure the step response of each arm joint in the physics simulation.
    Print the gains, the error and the sag under gravity.

    Exit status 0 if every joint settles within 2 % and none sags by more than 1 mrad (1 mm), 1 if not.
    """
    for file in (plot, json_file):
        if file is not None:
            check_writable(file)
    from armcell.cell import load
    from armcell.sim.gain_files import with_gains
    from armcell.sim.joint_gains import arm_joints
    from armcell.sim.settings import effective_gains
    from armcell.sim.step_response import sag, step_responses

    loaded = load(cell)
    scene, model = loaded.scene(), loaded.model
    settings = loaded.physics if gains is None else with_gains(loaded.physics, gains, model)
    joints = tuple(arm_joints(model))
    if group is not None:
        joints = tuple(j for j in model.group(group).joint_names if j in joints)
    drives = {joint: effective_gains(model.joint(joint), settings) for joint in joints}
    sagged = sag(scene, settings)
    found = step_responses(scene, joints, settings, float(np.deg2rad(size_deg)), seconds)
    slides = {joint for joint in joints if model.joint(joint).type == "prismatic"}
    console.print(_table(found, drives, sagged, slides))
    if plot is not None:
        from armcell.records.plots import response_plot

        titles = {j: f"{j}: kp {d.kp:.4g}, ki {d.ki:.4g}, kv {d.kv:.4g}" for j, d in drives.items()}
        curves = {titles[r.joint]: r.positions / r.size for r in found}
        title = f"{loaded.name}, arm_control: {settings.arm_control}, step of {size_deg:g} deg"
        plot.write_bytes(response_plot(found[0].times, curves, title))
        console.print(f"plot: {plot}")
    if json_file is not None:
        write_json(json_file, {r.joint: _numbers(r, drives[r.joint], sagged[r.joint]) for r in found})
    good = all(np.isfinite(r.settling_time) and sagged[r.joint] <= 1e-3 for r in found)
    return 0 if good else 1


def _table(found: Any, drives: Any, sagged: dict[str, float], slides: set[str]) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("joint", no_wrap=True)
    for title in ("kp", "ki", "kv", "rise", "overshoot", "settled", "end error", "sag"):
        table.add_column(title, justify="right")
    for r in found:
        drive, unit = drives[r.joint], "mm" if r.joint in slides else "mrad"
        table.add_row(
            r.joint, f"{drive.kp:.4g}", f"{drive.ki:.4g}", f"{drive.kv:.4g}", _seconds(r.rise_time),
            f"{100 * r.overshoot:.1f} %", _seconds(r.settling_time), f"{1000 * r.final_error:.2f} {unit}",
            f"{1000 * sagged[r.joint]:.2f} {unit}",
        )  # fmt: skip
    return table


def _seconds(value: float) -> str:
    return f"{value:.3f} s" if np.isfinite(value) else "never"


def _numbers(r: Any, drive: Any, sagged: float) -> dict[str, float | None]:
    finite = lambda v: float(v) if np.isfinite(v) else None  # noqa: E731
    return {
        "kp": drive.kp,
        "ki": drive.ki,
        "kv": drive.kv,
        "rise_time_s": finite(r.rise_time),
        "overshoot": r.overshoot,
        "settling_time_s": finite(r.settling_time),
        "final_error": r.final_error,
        "sag": sagged,
    }
