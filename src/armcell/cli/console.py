"""Console output of the commands: text, tables, JSON files, and the addresses of servers."""

from __future__ import annotations

import json
import os
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from armcell.core import InputError
from armcell.core.network_endpoints import Endpoint

PIPE_WIDTH = 400
"""Line width without a terminal: programs that read a pipe need whole lines."""

console = Console(highlight=False, width=None if sys.stdout.isatty() else PIPE_WIDTH)
errors = Console(stderr=True, highlight=False, soft_wrap=True)


def err(text: str) -> None:
    """Print one line about a command to standard error on the console."""
    errors.print(f"armcell: {text}", markup=False)


def check_writable(path: Path) -> None:
    """Check that the output file of a console command can be written, before a long run starts.

    Raises:
        InputError: the folder is missing or not writable, or the path is a folder.
    """
    folder = path.resolve().parent
    if os.path.isdir(path):
        raise InputError("is a folder, a file name is needed", file=path)
    if not os.path.isdir(folder):
        raise InputError("folder does not exist", file=folder, hint=f"mkdir -p {folder}")
    try:  # os.access always returns True for root
        handle, trial = tempfile.mkstemp(dir=folder, prefix=f".{path.name}.")
    except OSError as error:
        raise InputError(f"folder is not writable ({error.strerror})", file=folder) from None
    os.close(handle)
    os.unlink(trial)


def write_json(path: Path, data: Any) -> None:
    """Write a JSON file of a console command atomically: first a temporary file, which is then renamed."""
    text = json.dumps(data, indent=2, sort_keys=True, allow_nan=False) + "\n"
    handle, temporary = tempfile.mkstemp(dir=path.resolve().parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def millimeters(value: float | None, digits: int = 1) -> str:
    return "" if value is None else f"{value * 1000:.{digits}f} mm"


def stage_table(result: dict[str, Any]) -> Table:
    """Return a table of the stages in a run, to be printed on the console."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    for title in ("stage", "planned by", "planning", "motion", "clearance", "slip", "error"):
        number = title in ("planning", "motion", "clearance", "slip")
        table.add_column(title, justify="right" if number else "left", overflow="fold")
    for stage in result["stages"]:
        table.add_row(
            stage["name"],
            stage["planner"],
            f"{stage['planning_time_s'] * 1000:.0f} ms" if stage["planner"] else "",
            f"{stage['motion_time_s']:.2f} s",
            millimeters(stage["clearance_m"]),
            millimeters(stage["slip_m"], 2),
            stage["error"],
            style=None if stage["ok"] else "red",
        )
    return table


def print_addresses(endpoints: Iterable[Endpoint], to: Console = console) -> None:
    """Print on the console the addresses on which a command's server listens, e.g. `listening on tcp
    127.0.0.1:10000 (ROS-TCP), ...`.
    """
    found = ", ".join(str(endpoint) for endpoint in endpoints)
    to.print(f"listening on {found or 'no port'}", markup=False, soft_wrap=True)
