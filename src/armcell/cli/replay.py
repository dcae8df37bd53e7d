"""`armcell replay`: show or repeat a recorded run; `armcell diff`: compare two records."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from armcell.cli.console import check_writable, console, err, write_json
from armcell.cli.page import ALLOW_HOST, HOST, OPEN, PORT, serve_page
from armcell.cli.run_record import write_result_files

REPLAY_EXAMPLES = """
Examples:

  armcell replay runs/20261122-101500-panda_pick              in the browser, with a time slider

  armcell replay runs/20261122-101500-panda_pick --execute    run it again: is every state the same?
"""
DIFF_EXAMPLES = """
Examples:

  armcell diff runs/20261122-101500-panda_pick runs/20261122-101530-panda_pick
"""


def replay(
    run: Path = typer.Argument(..., help="Folder of a run, or its run.mcap."),
    execute: bool = typer.Option(
        False, "--execute", help="Run the task again and compare every recorded state, bit for bit."
    ),
    anyway: bool = typer.Option(
        False, "--anyway", help="With --execute: also where cell, script or versions have changed since."
    ),
    runs: Path = typer.Option(
        Path("runs"), metavar="FOLDER", help="Where --execute puts the new run's folder."
    ),
    json_file: Path | None = typer.Option(None, "--json", metavar="FILE", help="With --execute: as JSON."),
    host: str = HOST,
    port: int = PORT,
    allow_host: list[str] = ALLOW_HOST,
    open_browser: bool = OPEN,
) -> int:
    """Replay a recorded run in the browser with a time slider, or repeat the run and compare it bit for bit.

    With --execute, the exit status is 0 if all recorded states, events and plans are equal, 1 if not.
    A truncated record (killed process, full disk) is shown up to its end.
    """
    from armcell.records import read_record

    if json_file is not None:
        check_writable(json_file)
    record = read_record(run)
    if record.cut:
        err(f"{record.file}: {record.cut}; what is before is shown")
    if execute:
        return _execute(record, runs, anyway, json_file)
    from armcell.core import InputError
    from armcell.records import recorded_cell
    from armcell.viewer.replay import ReplayView

    if not record.metadata:
        raise InputError(
            "does not say which cell ran",
            file=record.file,
            hint="it still opens in Foxglove (app.foxglove.dev)",
        )
    scene = recorded_cell(record.metadata).scene(record.metadata["seed"])
    with ReplayView(record, scene, host, port, allow_host) as view:
        serve_page(view.viewer.page, open_browser)


def _execute(record: Any, runs: Path, anyway: bool, json_file: Path | None) -> int:
    from armcell.records import new_run_folder, reexecute
    from armcell.records.reexecution import checked_cell

    checked_cell(record, anyway)  # report errors before creating a folder
    folder = new_run_folder(runs, f"{record.metadata['cell']}-again")
    found, result, recorder = reexecute(record, folder, anyway)
    console.print(f"run again: {folder}", soft_wrap=True)
    _print(found)
    write_result_files(recorder, result)
    if json_file is not None:
        write_json(json_file, _as_json(found))
    return 0 if found.same_course else 1


def diff(
    first: Path = typer.Argument(..., metavar="RUN1", help="Folder of a run, or its run.mcap."),
    second: Path = typer.Argument(..., metavar="RUN2"),
    json_file: Path | None = typer.Option(None, "--json", metavar="FILE", help="Write it as JSON."),
) -> int:
    """Print how two recorded runs differ: the first different state,
    event and plan, and the largest deviation.

    Exit status 0 if the runs are equal, 1 if not. Planning times depend on the wall clock and do not count.
    """
    from armcell.records import compare, read_record

    if json_file is not None:
        check_writable(json_file)
    found = compare(read_record(first), read_record(second))
    _print(found)
    if json_file is not None:
        write_json(json_file, _as_json(found))
    return 0 if found.same_course and found.outcome is None else 1


def _print(found: Any) -> None:
    for line in found.words():
        console.print(line, markup=False, soft_wrap=True)


def _as_json(found: Any) -> dict[str, Any]:
    def parting(each: Any) -> Any:
        if each is None:
            return None
        values = (
            v if isinstance(v, float | int | str | bool) or v is None else str(v)
            for v in (each.first, each.second)
        )
        return {"time_s": each.time, "what": each.what, "values": list(values)}

    return {
        "identical": found.identical,
        "states": found.states,
        "same_states": found.same_states,
        "asked": list(found.input_differences),
        "cut": list(found.cut),
        **{k: parting(getattr(found, k)) for k in ("state", "event", "plan", "outcome")},
        "distances": [
            {"what": d.what, "largest": d.largest, "at_s": d.at, "above": [list(r) for r in d.reached]}
            for d in found.distances
        ],
    }
