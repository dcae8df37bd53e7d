"""Recording of a run: the run folder, pictures of key moments, and camera frames."""

from __future__ import annotations

import hashlib
import shlex
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer

from armcell.cli.camera_frames import camera_frames
from armcell.cli.console import err
from armcell.cli.gate_check import gate_summary, warn_without_twin
from armcell.cli.results import write_result_files
from armcell.core import ArmcellError, ErrorCode, Event, InputError, Observer, Outcome

RECORD = typer.Option(
    None, "--record/--no-record", show_default=False,
    help="Keep all that happens in a run folder, as `armcell run` does. Default: in mode real.",
)  # fmt: skip
RUNS = typer.Option(None, metavar="FOLDER", help="Record there. [default: runs]")


def records_folder(record: bool | None, mode: str, runs: Path | None) -> Path | None:
    """Return the folder in which the recording options tell a command to create its run folders.
    Return None if the run is not recorded.
    """
    wanted = (mode == "real" or runs is not None) if record is None else record
    return (runs or Path("runs")) if wanted else None


@dataclass(frozen=True)
class RecordingOptions:
    """Options for recording a run: the folder and the pictures.

    Attributes:
        runs: folder of run folders; None for no record.
        json_file: additional file for the result.
        frames: CAMERA or CAMERA=HZ, each.
    """

    runs: Path | None
    json_file: Path | None = None
    frames: Sequence[str] = ()


def begin_record(
    cell: Any,
    scene: Any,
    seed: int | None,
    mode: str,
    kept: RecordingOptions,
    values: dict[str, Any],
    **more: Any,
) -> Any:
    """Return a recorder that writes a command's run to a new folder, for use in a `with` block.
    Return None if the run is not recorded.

    Args:
        more: further data about the run for the record.
    """
    if kept.runs is None:
        return None
    from armcell.records import RunRecorder, new_run_folder, run_metadata

    about = {**run_metadata(cell, seed, mode, values), **more}
    return RunRecorder(new_run_folder(kept.runs, cell.name), scene, metadata=about)


def add_picture_observers(live: Any, cell: Any, mode: str, recorder: Any, kept: RecordingOptions) -> None:
    """Add observers that take pictures of a connected cell, if the recording options request pictures."""
    from armcell.cell.pictures import Pictures

    if recorder is not None and mode == "sim" and cell.cameras:
        live.ctx.observers.append(Pictures(live, recorder.add_picture))
    if kept.frames:
        live.ctx.observers += camera_frames(kept.frames, live, mode, recorder)


def error_text(error: BaseException | None) -> str:
    """Describe, for the record of a run, the exception that made the run fail.
    The text is empty if there was no exception.
    """
    if error is None or isinstance(error, ArmcellError):
        return "" if error is None else str(error)
    return f"{type(error).__name__}: {error}"


class ExternallyControlledRun:
    """Record of a run that is controlled by a script, by clients of a served cell,
    or by a user in the browser.

    If `end` was called, the end of the `with` block writes the result and the report. The record is closed in
    any case.

    Args:
        by: who controls the run, in words.
        command: the command line.
        script: the script file, if a script controls the run.
        gate: the result of `check_gate` or `require_gate_override`.
    """

    def __init__(
        self,
        cell: Any,
        scene: Any,
        seed: int | None,
        mode: str,
        kept: RecordingOptions,
        values: dict[str, Any],
        by: str,
        command: Sequence[str],
        script: Path | None = None,
        gate: dict[str, Any] | None = None,
    ):
        self._cell, self._seed, self._mode, self._kept = cell, seed, mode, kept
        self._gate, self._command = gate or {}, shlex.join(command)
        self._began = time.monotonic()
        self.result: dict[str, Any] | None = None
        more = {"by": by, **self._gate}
        if script is not None:
            more["script"] = hashlib.sha256(script.read_bytes()).hexdigest()[:32]
        self.recorder = begin_record(cell, scene, seed, mode, kept, values, **more)

    @property
    def observers(self) -> list[Observer]:
        """Return the observers that record a run of the cell."""
        return [] if self.recorder is None else [self.recorder]

    def begin(self, live: Any) -> None:
        """Begin the record of a run: add the observers that take pictures, and note how the gate check of
        real arms was passed or overridden.

        Also print a warning if real arms move without being compared with a simulated twin. Call this method
        before the `with` block of the live cell.
        """
        warn_without_twin(live.driver, str(self._cell.file))
        add_picture_observers(live, self._cell, self._mode, self.recorder, self._kept)
        if self.recorder is not None and self._gate:
            self.recorder.on_event(Event(0.0, "note", gate_summary(self._gate)))

    def end(self, call: Callable[[Callable[[], Any]], Any], live: Any, failure: str = "") -> None:
        """Store the result of a run in its record.

        Args:
            call: calls a function in the thread that steps the cell, and returns its result.
            failure: the reason for a failure; empty after a success.
        """
        from armcell.cell import result_of

        outcome = Outcome(ErrorCode.FAILURE if failure else ErrorCode.SUCCESS, failure)
        wall = time.monotonic() - self._began
        found = call(lambda: result_of(self._cell, live, self._seed, self._mode, outcome, wall))
        self.result = {**found, **self._gate, "command": self._command}

    def __enter__(self) -> ExternallyControlledRun:
        return self

    def __exit__(self, kind: type[BaseException] | None, *more: Any) -> None:
        if self.result is None:
            if self.recorder is not None:
                self.recorder.__exit__(kind, *more)
            return
        try:
            report = write_result_files(self.recorder, self.result, self._kept.json_file)
        except InputError as error:
            if self.result["success"]:
                raise
            err(str(error))  # the run's own failure has priority
            return
        if report is not None:
            err(f"report: {report}")
