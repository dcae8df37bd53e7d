"""`armcell bench grasp`: pick, lift, hold and place objects in physics."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from rich.progress import track
from rich.table import Table

from armcell.cli.console import check_writable, console, errors, write_json
from armcell.core import InputError

if TYPE_CHECKING:
    from armcell.cell.grasp_benchmark import ObjectResult

EXAMPLES = """
Examples:

  armcell bench grasp                                         the library's objects

  armcell bench grasp --objects meshes/ --json grasps.json    and those of a folder, a row per object

  armcell bench grasp --objects parts_mm/ --scale 0.001       meshes in millimeters
"""


def grasp(
    objects: Path | None = typer.Option(
        None, metavar="FOLDER", help="Also the meshes in here, or the URDFs if it has some."
    ),
    count: int = typer.Option(100, min=1, help="How many of the folder's files, by name."),
    skip: int = typer.Option(0, min=0, help="Leave out so many of the folder's files first."),
    scale: float = typer.Option(
        1.0, min=1e-9, help="Meters per unit of the mesh files; URDFs have their own."
    ),
    library: bool = typer.Option(True, help="The objects that armcell brings."),
    robot: str = typer.Option("panda", help="A robot of the library with a gripper."),
    candidates: int = typer.Option(16, min=1, help="Grasps proven in physics before one is chosen."),
    proof_trials: int = typer.Option(8, min=1, help="Trials of each."),
    seed: int = typer.Option(0, min=0, help="Of planners and of the grasps drawn at random."),
    recover: bool = typer.Option(True, help="Where the first attempt fails, try once more with three."),
    predictions: int = typer.Option(6, min=0, help="Grasps drawn at random per object, to judge P by."),
    json_file: Path | None = typer.Option(
        None, "--json", metavar="OUT", help="A summary and a row per object."
    ),
) -> int:
    """Benchmark picks in which only friction holds the object: grasp each object, lift it by 20 cm, hold it
    for 5 s and place it within 1 cm of its goal.

    Each object starts at rest on a table. An object from a file is scaled down if its narrowest side takes
    more than 75 % of the gripper's opening; objects that still cannot be gripped are counted separately.
    "Success" is the first attempt; if it fails, a second run allows three attempts ("with recovery").
    P is the predicted success: the share of successes in trials of the hand alone with noise. To validate P,
    whole robots pick with randomly drawn grasps; pose, friction and mass of the object differ from the
    believed ones. The table compares the Brier score of P (0 is best) with those of a curve fitted to epsilon
    and of the plain share of successes.
    Exit status 1 if less than 95 % of the graspable objects succeed at the first attempt, or less than 99 %
    with recovery.
    """
    from armcell.cell.grasp_benchmark import Bench, TrialOptions, made_objects, objects_of, summary

    if json_file is not None:
        check_writable(json_file)
    bench = Bench(TrialOptions(robot, candidates, proof_trials, seed, predictions, recover))
    todo = list(made_objects()) if library else []
    if objects is not None:
        found_there = list(objects_of(objects, bench.gripper, count, scale, skip))
        bad = [item for _, item, _ in found_there if isinstance(item, InputError)]
        if len(bad) == len(found_there):
            raise bad[0]
        todo += found_there
    rows: list[ObjectResult] = []

    def save(found: dict[str, Any] | None) -> None:
        if json_file is not None:
            data = {"summary": found, "robot": robot, "seed": seed, "rows": [asdict(r) for r in rows]}
            write_json(json_file, data)

    for name, item, shrunk in track(
        todo, "picking", console=errors, disable=not errors.is_terminal, transient=True
    ):
        rows.append(bench.run(name, item, shrunk))
        save(None)  # keep the finished rows if the run is interrupted
    found = summary(rows, recover)
    _show(rows, found)
    save(found)
    wanted = {"first_attempt": 0.95, **({"with_recovery": 0.99} if recover else {})}
    return 0 if found["graspable"] and all(found[k]["share"] >= w for k, w in wanted.items()) else 1


def _show(rows: list[ObjectResult], found: dict[str, Any]) -> None:
    table = Table(box=None, pad_edge=False, header_style="bold")
    for title in ("object", "scale", "grasps", "result", "P", "epsilon", "off by", "slip", "reason"):
        table.add_column(title, justify="left" if title in ("object", "result", "reason") else "right")
    for r in rows:
        result = (
            "not graspable"
            if not r.graspable
            else "ok"
            if r.success
            else "recovered"
            if r.recovered
            else "failed"
        )
        table.add_row(
            r.name, f"{r.scale:.2f}", str(r.candidates), result,
            "" if r.probability is None else f"{r.probability:.2f}",
            "" if r.epsilon is None else f"{r.epsilon:.3f}",
            "" if r.error_m is None else f"{r.error_m * 1000:.1f} mm",
            "" if r.slip_m is None else f"{r.slip_m * 1000:.2f} mm",
            r.reason,
        )  # fmt: skip
    console.print(table)
    for what in ("first_attempt", *(("with_recovery",) if "with_recovery" in found else ())):
        s = found[what]
        share = "none" if s["share"] is None else f"{100 * s['share']:.1f} %"
        console.print(
            f"{what.replace('_', ' ')}: {share} ({s['successes']} of {s['trials']}, "
            f"95 % interval {100 * s['low']:.1f} to {100 * s['high']:.1f} %)"
        )
    if "brier_proof" in found:
        _show_predictions(found)


def _show_predictions(found: dict[str, Any]) -> None:
    low, high = found["brier_lead_interval"]
    console.print(
        f"Brier score of {found['predictions']} predictions: {found['brier_proof']:.4f} by trials, "
        f"{found['brier_epsilon']:.4f} by epsilon, {found['brier_base_rate']:.4f} by the share alone "
        f"({found['predictions'] - found['successes_of_predictions']} failures; "
        f"the lead over epsilon is {found['brier_lead']:.4f}, 95 % interval {low:.4f} to {high:.4f})"
    )
    table = Table(box=None, pad_edge=False, header_style="bold")
    for title in ("P", "trials", "predicted", "happened"):
        table.add_column(title, justify="right")
    for b in found["reliability"]:
        shares = (f"{100 * b[k]:.1f} %" for k in ("predicted", "happened"))
        table.add_row(f"{b['from']:.2f} to {b['to']:.2f}", str(b["n"]), *shares)
    console.print(table)
