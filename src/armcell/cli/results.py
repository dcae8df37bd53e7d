"""Writer for the files of a finished run: result, record and report."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from armcell.cli.console import write_json
from armcell.core import InputError


def write_result_files(recorder: Any, result: dict[str, Any], json_file: Path | None = None) -> Path | None:
    """Write the files of a run: result, record and report. Call this after the result was printed.

    A failure to write (e.g. a full disk) then does not hide the result.

    Args:
        recorder: the recorder with the run folder; None for a run without a record.
        json_file: additional file for the result.
    Returns:
        The report file; None without a recorder.
    Raises:
        InputError: files could not be written; all other files are written.
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
            hint="the run itself ended as shown; make room, or choose another folder with --runs or --json",
        )  # fmt: skip
    return report
