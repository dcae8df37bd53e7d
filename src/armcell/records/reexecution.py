"""Re-execution of a recorded run, and the check that the result is bit-identical."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from armcell.cell import announce_code, run_task
from armcell.core import InputError, Observer
from armcell.planning import warm_up
from armcell.records.compare import Comparison, compare
from armcell.records.metadata import changed_since, origin_of, recorded_cell, run_metadata
from armcell.records.reader import Record, read_record
from armcell.records.recorder import RunRecorder

REPEATABLE = ("sim", "fake")


def reexecute(
    record: Record, folder: Path, anyway: bool = False, observers: Sequence[Observer] = ()
) -> tuple[Comparison, dict[str, Any], RunRecorder]:
    """Execute the task of a recorded run again and record the new run into a folder.

    Args:
        anyway: execute even if files or versions have changed since the recording.
    Returns:
        Comparison of both runs, result of the new run, and its recorder (closed).
    Raises:
        InputError: the record has no run metadata, was made with a real arm, or its inputs have changed.
    """
    cell = checked_cell(record, anyway)
    seed, mode = int(record.metadata["seed"]), str(record.metadata["mode"])
    metadata = run_metadata(cell, seed, mode, record.metadata.get("values", {}))
    warm_up()
    recorder = RunRecorder(folder, cell.scene(seed), metadata=metadata)
    with recorder, cell.connect(mode, seed, [recorder, *observers]) as live:
        result = run_task(cell, live, seed, mode)
        result["command"] = command_of(record)
        recorder.finish(result)
    return compare(record, read_record(folder)), result, recorder


def checked_cell(record: Record, anyway: bool = False) -> Any:
    """Return the cell of a recorded run for re-execution, after checking that the run can be reproduced.

    Raises:
        InputError: the run is not reproducible; the text gives the cause.
    """
    if not record.metadata:
        raise InputError(
            "does not say what ran", file=record.file,
            hint="records of `armcell run` do; this one can be looked at: armcell replay without --execute",
        )  # fmt: skip
    if by := record.metadata.get("by"):
        raise InputError(
            f"was led by {by}, by the clock on the wall: that need not repeat itself", file=record.file,
            hint="armcell replay shows it; armcell diff compares it with another run",
        )  # fmt: skip
    mode = record.metadata["mode"]
    if mode not in REPEATABLE:
        raise InputError(
            f"is of mode {mode}: only physics repeats itself", file=record.file,
            hint="armcell replay shows it; armcell diff compares it with another run",
        )  # fmt: skip
    cell = recorded_cell(record.metadata)
    changed = changed_since(record.metadata, cell)
    if changed and not anyway:
        raise InputError(
            f"changed since this record: {', '.join(changed)}", file=record.file,
            hint="restore it, or compare all the same with --anyway",
        )  # fmt: skip
    announce_code(cell, origin_of(record.metadata, record.file))
    return cell


def command_of(record: Record) -> str:
    """Return the shell command that started a recorded run, so that it can be executed again."""
    result: Mapping[str, Any] = record.result or {}
    return str(
        result.get("command") or f"armcell run {record.metadata['cell']} --seed {record.metadata['seed']}"
    )
