"""What a run leaves on disk: its numbers, the end of its record, its report."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from armcell.cli.console import write_json
from armcell.core import InputError


def keep_result(recorder: Any, result: dict[str, Any], json_file: Path | None = None) -> Path | None:
    """Write what a run ended with, after it was shown: a disk may be full.

    Args:
        recorder: of the run, which has its folder; None for a run without.
        json_file: the numbers go there, too.
    Returns:
        The report, of a run with a recorder.
    Raises:
        InputError: what could not be written; whatever else could be, is.
    """
    failed: dict[Path, OSError] = {}
    report = None
    if json_file is not None:
        try:
            write_json(json_file, result)
        except OSError as error:
            failed[json_file] = error
    if recorder is not None:
        from armcell.records import write_report

        recorder.finish(result)
        numbers = recorder.folder / "result.json"
        try:
            write_json(numbers, result)
        except OSError as error:
            failed[numbers] = error
        try:
            report = write_report(recorder.folder, result, recorder)
        except OSError as error:
            failed[recorder.folder / "report.html"] = error
    if failed:
        file, error = next(iter(failed.items()))
        more = "".join(f", nor {other.name}" for other in list(failed)[1:])
        raise InputError(
            f"cannot be written{more}: {error.strerror}", file=file,
            cure="the run itself ended as shown; make room, or choose another folder with --runs or --json",
        )  # fmt: skip
    return report
