"""What a run leaves on disk: its numbers, the end of its record, its report."""

from __future__ import annotations

from collections.abc import Callable
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
    report = None
    files: dict[Path, Callable[[Path], object]] = {}
    if json_file is not None:
        files[json_file] = lambda file: write_json(file, result)
    if recorder is not None:
        from armcell.records import REPORT_FILE, write_report

        recorder.finish(result)
        report = recorder.folder / REPORT_FILE
        files[recorder.folder / "result.json"] = lambda file: write_json(file, result)
        files[report] = lambda file: write_report(file.parent, result, recorder)
    failed: dict[Path, OSError] = {}
    for file, write in files.items():
        try:
            write(file)
        except OSError as error:
            failed[file] = error
    if failed:
        file, error = next(iter(failed.items()))
        more = "".join(f", nor {other.name}" for other in list(failed)[1:])
        raise InputError(
            f"cannot be written{more}: {error.strerror}", file=file,
            cure="the run itself ended as shown; make room, or choose another folder with --runs or --json",
        )  # fmt: skip
    return report
