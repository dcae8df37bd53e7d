"""Execution of one trial: the cell with drawn values, its task in physics, a result row."""

from __future__ import annotations

import json
import shlex
import time
import traceback
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from armcell.cell import Cell, run_task
from armcell.cell.value_overrides import with_values
from armcell.core import ErrorCode, InputError


@dataclass(frozen=True)
class Trial:
    """One trial of a campaign: its number, its seed and the values of its parameters.

    `number` counts from 0. `seed` seeds the planners and the cell's `randomize` draw. `values` holds the
    varied values by path, `draw` the numbers in [0, 1) behind them. `near_failure` is True if adaptive
    sampling placed the trial near a failure.
    """

    number: int
    seed: int
    values: Mapping[str, Any]
    draw: tuple[float, ...] = ()
    near_failure: bool = False


def run_trial(cell: Cell, trial: Trial) -> dict[str, Any]:
    """Run one campaign trial in simulation and return its result row.

    Returns:
        A JSON-ready row. Repeating a trial gives the same row except for `wall_s`, `cpu_s` and `planning_s`.
        Every error becomes a failed trial with its cause, never an exception.
    """
    began, cpu = time.monotonic(), time.process_time()
    try:
        varied = with_values(cell, trial.values)
        with varied.connect("sim", trial.seed) as live:
            row = row_of(trial, run_task(varied, live, trial.seed, "sim"))
        live.release()  # the next trial reuses the memory
    except InputError as error:  # the values give an invalid cell
        row = failed(trial, "INVALID_CELL", str(error))
    except Exception as error:  # a bug: record it with its source line
        place = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{place.filename.rpartition('/')[2]}:{place.lineno}"
        row = failed(trial, "EXCEPTION", f"{type(error).__name__}: {error} ({where})")
    return {**row, "wall_s": time.monotonic() - began, "cpu_s": time.process_time() - cpu}


def row_of(trial: Trial, result: Mapping[str, Any]) -> dict[str, Any]:
    """Return the result row of a campaign trial from the result of its run."""
    failed_at = result["failed_at"] or {"stage": "", "pair": ""}
    return _row(
        trial,
        **failed_at,
        success=bool(result["success"]),
        error_name="" if result["success"] else ErrorCode(result["error_code"]).name,
        message=result["message"],
        randomized=result["randomized"],
        unwanted_contacts=len(result["unwanted_contacts"]),
        slip_m=result["slip_m"],
        placement_error_m=result["placement_error_m"],
        min_clearance_m=result["min_clearance_m"],
        task_time_s=result["task_time_s"],
        planning_s=result["total_planning_time_s"],
    )


def failed(trial: Trial, error_name: str, message: str) -> dict[str, Any]:
    """Return the result row of a campaign trial that did not finish, for example because its process crashed
    or ran out of time. The row states the error.
    """
    return _row(trial, success=False, error_name=error_name, message=message) | {"wall_s": 0.0, "cpu_s": 0.0}


def _row(trial: Trial, **found: Any) -> dict[str, Any]:
    nothing = {
        "stage": "", "pair": "", "randomized": {}, "unwanted_contacts": 0, "slip_m": None,
        "placement_error_m": None, "min_clearance_m": None, "task_time_s": None, "planning_s": None,
    }  # fmt: skip
    return {
        "trial": trial.number,
        "seed": trial.seed,
        "values": dict(trial.values),
        "draw": list(trial.draw),
        "near_failure": trial.near_failure,
        **nothing,
        **found,
    }


def replay_command(cell: str, row: Mapping[str, Any], values: Mapping[str, Any]) -> str:
    """Return the shell command that runs a trial of a campaign again and writes its report and record."""
    sets = [
        part
        for path, value in {**values, **row["values"]}.items()
        for part in ("--set", f"{path}={json.dumps(value)}")
    ]
    return shlex.join(["armcell", "run", cell, "--seed", str(row["seed"]), *sets])
