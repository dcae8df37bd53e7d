"""Recording of a run: run folder, pictures, camera frames (`--frames`), result and report files."""

from __future__ import annotations

import hashlib
import shlex
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer

from armcell.cli.console import err, write_json
from armcell.cli.gate import gate_summary, warn_without_twin
from armcell.core import (
    ArmcellError,
    ErrorCode,
    Event,
    InputError,
    JointTrajectory,
    Observer,
    Outcome,
    StateSample,
    UnknownNameError,
)

RATE = 5.0  # [Hz] of the cell's clock
RECORD = typer.Option(
    None, "--record/--no-record", show_default=False,
    help="Keep all that happens in a run folder, as `armcell run` does. Default: in mode real.",
)  # fmt: skip
RUNS = typer.Option(None, metavar="FOLDER", help="Record there. [default: runs]")


def camera_frames(wanted: Sequence[str], live: Any, mode: str, recorder: Any) -> list[CameraFrames]:
    """Return the observers that add camera frames to the record of a run, as requested by the option
    `--frames`.

    Args:
        wanted: CAMERA or CAMERA=HZ, each.
    Raises:
        InputError: the run has no physics or no record, or a rate is invalid.
        UnknownNameError: a camera does not exist.
    """
    if recorder is None or mode != "sim":
        raise InputError("--frames needs physics and a record", hint="mode sim, and no --headless")
    known = live.cameras
    found = []
    for each in wanted:
        name, _, rate = each.partition("=")
        if name not in known:
            raise UnknownNameError("camera", name, known)
        try:
            hertz = float(rate or RATE)
        except ValueError:
            hertz = 0.0
        if not 0 < hertz <= 100:
            raise InputError(
                f"--frames {each}: {rate!r} is no rate", hint="a number of Hz up to 100: overview=10"
            )
        found.append(CameraFrames(live.driver, known[name], hertz, recorder))
    return found


class CameraFrames:
    """Observer that adds frames of a camera to the record of a run, at a fixed rate [Hz] on the cell's clock
    (option `--frames`).
    """

    def __init__(self, driver: Any, camera: Any, rate: float, recorder: Any):
        self._driver, self._camera, self._period, self._recorder = driver, camera, 1.0 / rate, recorder
        self._due = 0.0

    def on_state(self, sample: StateSample) -> None:
        if sample.time < self._due - 1e-9:
            return
        self._due = sample.time + self._period
        if self._driver.is_paced:  # asynchronous: a step must not wait for a picture
            self._camera.ask("frames", self._keep, depth=False)
        else:
            self._keep(self._camera.draw(depth=False))

    def _keep(self, image: Any) -> None:
        self._recorder.add_frame(image.time, image.camera, image.rgb)

    def on_event(self, event: Event) -> None:
        pass

    def on_trajectory(self, time: float, trajectory: JointTrajectory) -> None:
        pass


def write_result_files(recorder: Any, result: dict[str, Any], json_file: Path | None = None) -> Path | None:
    """Write the files of a run: result, record and report. Call this after the command has printed the
    result.

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


def records_folder(record: bool | None, mode: str, runs: Path | None) -> Path | None:
    """Return the folder in which a command creates its run folders, as set by the recording options. Return
    None if the run is not recorded.
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
        """Return the observers that write a command's run record."""
        return [] if self.recorder is None else [self.recorder]

    def begin(self, live: Any) -> None:
        """Begin the record of a run: add the observers that take pictures, and note whether the run passed
        the gate check for real arms or the user overrode this check.

        Also print a warning if real arms move without being compared with a simulated twin. Call this method
        before the `with` block of the live cell.
        """
        warn_without_twin(live.driver, str(self._cell.file))
        add_picture_observers(live, self._cell, self._mode, self.recorder, self._kept)
        if self.recorder is not None and self._gate:
            self.recorder.on_event(Event(0.0, "note", gate_summary(self._gate)))

    def end(self, call: Callable[[Callable[[], Any]], Any], live: Any, failure: str = "") -> None:
        """Store the result of a run in the command's run record.

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
