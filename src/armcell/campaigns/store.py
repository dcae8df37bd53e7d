"""Folder of a campaign: the specification and one line per finished trial.

campaign.json holds the specification and trials.jsonl the trials. Each line is appended with a single write.
A killed process loses only the trial that it was running. An incomplete line (full disk, machine failure) is
dropped when the folder is opened again. The file is plain JSON lines, which pandas, DuckDB and `jq` can read.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from armcell.campaigns.spec import CampaignSpec
from armcell.core import InputError
from armcell.records import new_run_folder

ASKED, TRIALS = "campaign.json", "trials.jsonl"
FORMAT = 1
_MEASURED = (int, float, type(None))
ROW = {
    **dict.fromkeys(("trial", "seed", "unwanted_contacts"), (int,)),
    **dict.fromkeys(("success", "near_failure"), (bool,)),
    **dict.fromkeys(("error_name", "message", "stage", "pair"), (str,)),
    **dict.fromkeys(("values", "randomized"), (dict,)), "draw": (list,),
    **dict.fromkeys(("slip_m", "placement_error_m", "min_clearance_m", "task_time_s"), _MEASURED),
    **dict.fromkeys(("planning_s", "wall_s", "cpu_s"), _MEASURED),
}  # fmt: skip
"""Keys of a trial's row (see `trial.row_of`) and the types of their values."""


class Store:
    """Folder that stores one campaign. Only one process at a time can hold the lock on it.

    Attributes:
        spec: the campaign's specification.
        hashes: content hashes of the cell when the campaign began; see `content_hashes`.
        rows: finished trials by number.
        dropped: bytes dropped from an incomplete last line.
    """

    def __init__(self, folder: Path, spec: CampaignSpec, hashes: Mapping[str, str]):
        self.folder, self.spec, self.hashes = folder, spec, dict(hashes)
        self.rows: dict[int, dict[str, Any]] = {}
        self.dropped = 0
        try:
            self._file = os.open(folder / TRIALS, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o644)
        except OSError as error:
            raise InputError(f"cannot be written ({error.strerror})", file=folder / TRIALS) from None
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(self._file)
            raise InputError("another process works on this campaign", file=folder) from None
        try:
            self._read()
        except InputError:
            self.close()
            raise

    @staticmethod
    def new(root: Path, spec: CampaignSpec, hashes: Mapping[str, str]) -> Store:
        """Create the store of a new campaign: a folder inside the folder `root`, which is usually "runs"."""
        folder = new_run_folder(root, f"campaign-{Path(spec.cell).stem}")
        asked = {"format": FORMAT, "spec": spec.as_dict(), "hashes": dict(hashes)}
        try:
            (folder / ASKED).write_text(json.dumps(asked, indent=2) + "\n", encoding="utf-8")
        except OSError as error:
            raise InputError(f"cannot be written ({error.strerror})", file=folder / ASKED) from None
        return Store(folder, spec, hashes)

    @staticmethod
    def open(folder: str | Path) -> Store:
        """Open the store of an existing campaign, given the campaign's folder.

        Raises:
            InputError: the folder contains no campaign, or one of another format version.
        """
        spec, hashes = stored_spec(Path(folder))
        return Store(Path(folder), spec, hashes)

    def _read(self) -> None:
        found, size = rows_of(self.folder / TRIALS)
        self.rows = {row["trial"]: row for row in reversed(found)}  # of duplicates, the first counts
        self.dropped = os.fstat(self._file).st_size - size
        if self.dropped:
            os.ftruncate(self._file, size)

    def append(self, row: Mapping[str, Any]) -> None:
        """Store the result of a finished trial in the campaign's folder.
        If the trial is already stored, do nothing.

        Raises:
            InputError: the disk is full or missing; earlier rows stay intact.
        """
        if row["trial"] in self.rows:
            return
        line = (json.dumps(row, allow_nan=False) + "\n").encode()
        before = os.fstat(self._file).st_size
        try:
            if os.write(self._file, line) != len(line):
                raise OSError(0, "the disk is full")
        except OSError as error:
            with contextlib.suppress(OSError):  # a partial line that stays is dropped at the next read
                os.ftruncate(self._file, before)
            raise InputError(
                f"cannot be written ({error.strerror})", file=self.folder / TRIALS,
                hint=f"make room, then go on with --resume {self.folder}",
            ) from None  # fmt: skip
        self.rows[row["trial"]] = dict(row)

    def close(self) -> None:
        os.close(self._file)


def write_atomically(file: Path, data: bytes) -> None:
    """Write a file of a campaign atomically, so that readers see either
    the complete old file or the complete new file.

    Raises:
        InputError: the file is not writable, e.g. because the disk is full.
    """
    part = file.with_name(f"{file.name}.part")
    try:
        part.write_bytes(data)
        os.replace(part, file)
    except OSError as error:
        with contextlib.suppress(OSError):
            part.unlink()
        raise InputError(
            f"cannot be written ({error.strerror}); every finished trial is kept in {TRIALS}", file=file,
            hint="make room, then go on with armcell campaign --resume FOLDER",
        ) from None  # fmt: skip


def stored_spec(folder: Path) -> tuple[CampaignSpec, dict[str, str]]:
    """Read from the store of a campaign the specification with which the campaign was started, and the
    content hashes of its cell at that time.
    """
    file = folder / ASKED
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
        if data["format"] != FORMAT:
            raise InputError(f"is of format {data['format']}, this armcell reads {FORMAT}", file=file)
        return CampaignSpec(**data["spec"]), dict(data["hashes"])
    except FileNotFoundError:
        raise InputError("is no campaign's folder: it has no campaign.json", file=folder) from None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"cannot be read ({type(error).__name__}: {error})", file=file) from None


def _row(line: bytes) -> dict[str, Any]:
    """Parse and validate one line of trials.jsonl, in which the store of a campaign keeps the result of one
    trial.

    Raises:
        ValueError, KeyError, TypeError: the line is not a valid trial row.
    """

    def not_a_number(word: str) -> None:
        raise ValueError(word)

    row = json.loads(line, parse_constant=not_a_number)
    for key, kinds in ROW.items():
        if not isinstance(row[key], kinds) or (isinstance(row[key], bool) and bool not in kinds):
            raise TypeError(key)
    if not all(isinstance(drawn, dict) for drawn in row["randomized"].values()):
        raise TypeError("randomized")
    if not all(isinstance(share, float | int) for share in row["draw"]):
        raise TypeError("draw")
    return row


def rows_of(file: Path) -> tuple[list[dict[str, Any]], int]:
    """Read the complete lines of trials.jsonl from the store of a campaign. Return the parsed rows and the
    total length of these lines in bytes.

    Raises:
        InputError: a complete line is not a valid trial row.
    """
    try:
        data = file.read_bytes()
    except FileNotFoundError:
        return [], 0
    whole = data[: data.rfind(b"\n") + 1]
    rows = []
    for number, line in enumerate(whole.splitlines(), start=1):
        try:
            row = _row(line)
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            text = f"is no trial ({type(error).__name__})"
            raise InputError(text, file=file, line=number, hint="delete the line") from None
        rows.append(row)
    return rows, len(whole)
