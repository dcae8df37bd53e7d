"""A campaign's folder: what was asked (campaign.json) and one line per finished trial (trials.jsonl).

Lines are appended whole, one write each. A process that is killed loses what it was doing and nothing else; a
line that was cut off (a full disk, a lost machine) is dropped when the folder is opened again. The file is
plain JSON lines: pandas, DuckDB and `jq` read it as it is.
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
"""What a trial's row holds (`trial.told`), by key."""


class Store:
    """The folder of one campaign, held by one process at a time.

    Attributes:
        spec: what was asked.
        hashes: of what the cell said then; see `content_hashes`.
        rows: finished trials by number.
        dropped: bytes of a line that was cut off.
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
        """A folder of its own below `root`, usually "runs"."""
        folder = new_run_folder(root, f"campaign-{Path(spec.cell).stem}")
        asked = {"format": FORMAT, "spec": spec.as_dict(), "hashes": dict(hashes)}
        try:
            (folder / ASKED).write_text(json.dumps(asked, indent=2) + "\n", encoding="utf-8")
        except OSError as error:
            raise InputError(f"cannot be written ({error.strerror})", file=folder / ASKED) from None
        return Store(folder, spec, hashes)

    @staticmethod
    def open(folder: str | Path) -> Store:
        """A campaign that was begun.

        Raises:
            InputError: no campaign's folder, or one of another version.
        """
        spec, hashes = asked(Path(folder))
        return Store(Path(folder), spec, hashes)

    def _read(self) -> None:
        found, size = rows_of(self.folder / TRIALS)
        self.rows = {row["trial"]: row for row in reversed(found)}  # of a trial told twice the first counts
        self.dropped = os.fstat(self._file).st_size - size
        if self.dropped:
            os.ftruncate(self._file, size)

    def append(self, row: Mapping[str, Any]) -> None:
        """Keep a finished trial; one that is there already is passed over.

        Raises:
            InputError: the disk is full or gone; what was kept before stays whole.
        """
        if row["trial"] in self.rows:
            return
        line = (json.dumps(row, allow_nan=False) + "\n").encode()
        before = os.fstat(self._file).st_size
        try:
            if os.write(self._file, line) != len(line):
                raise OSError(0, "the disk is full")
        except OSError as error:
            with contextlib.suppress(OSError):  # a part of a line that stays is dropped when this is read
                os.ftruncate(self._file, before)
            raise InputError(
                f"cannot be written ({error.strerror})", file=self.folder / TRIALS,
                cure=f"make room, then go on with --resume {self.folder}",
            ) from None  # fmt: skip
        self.rows[row["trial"]] = dict(row)

    def close(self) -> None:
        os.close(self._file)


def write_whole(file: Path, data: bytes) -> None:
    """Write a file beside the trials; it appears whole, or stays as it was.

    Raises:
        InputError: it cannot be written, as on a full disk.
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
            cure="make room, then go on with armcell campaign --resume FOLDER",
        ) from None  # fmt: skip


def asked(folder: Path) -> tuple[CampaignSpec, dict[str, str]]:
    """What a campaign's folder says was asked, and the hashes of then."""
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
    """A trial's row.

    Raises:
        ValueError, KeyError, TypeError: it is not one.
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
    """The whole lines of a file of trials, and how many bytes they take.

    Raises:
        InputError: a whole line that is no trial.
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
            raise InputError(text, file=file, line=number, cure="delete the line") from None
        rows.append(row)
    return rows, len(whole)
