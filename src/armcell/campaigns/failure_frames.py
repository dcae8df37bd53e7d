"""Pictures of failed trials at the moment of failure, taken by running the trials again.

Trials are deterministic, so a second run with the same seed fails in the same state.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from armcell.campaigns.statistics import causes
from armcell.campaigns.store import Store, write_atomically
from armcell.cell import Cell, load, run_task
from armcell.cell.pictures import Picture, Pictures
from armcell.cell.value_overrides import with_values
from armcell.records import html

logger = logging.getLogger(__name__)

MOST = 12  # maximum number of pictures per campaign
LONGEST = 60.0  # [s] longer trials are not run again for a picture
NO_RUN = ("CRASHED", "TRIAL_TIMED_OUT", "INVALID_CELL")  # errors of trials that did not run to an end


def picture_file(folder: Path, number: int) -> Path:
    """Return the path for the picture of a failed trial. The file need not exist."""
    return folder / "pictures" / f"trial_{number}.png"


def take_pictures(store: Store, tell: Callable[[int, int], None] = lambda done, of: None) -> None:
    """Take missing pictures of failed trials. Take one picture of each failure cause before any others.

    Args:
        tell: called with the number of finished pictures and the total number.
    Raises:
        InputError: the folder is not writable, or the disk is full.
    """
    wanted = _wanted(store)
    if not wanted:
        return
    cell = with_values(load(store.spec.cell), store.spec.values)
    for done, row in enumerate(wanted):
        tell(done, len(wanted))
        file = picture_file(store.folder, row["trial"])
        if not os.path.exists(file) and (picture := failure_frame(cell, row)) is not None:
            with suppress(OSError):  # `write_atomically` reports the error
                file.parent.mkdir(exist_ok=True)
            write_atomically(file, html.picture_png(picture))
    tell(len(wanted), len(wanted))


def _wanted(store: Store) -> list[dict[str, Any]]:
    rows = [store.rows[number] for number in sorted(store.rows)]
    known = causes(rows)
    first = [cause.trials[0] for cause in known]
    others = sorted({number for cause in known for number in cause.trials} - set(first))
    shown = [
        row
        for row in map(store.rows.__getitem__, [*first, *others])
        if row["error_name"] not in NO_RUN and row["wall_s"] <= LONGEST
    ]
    return shown[:MOST]


def failure_frame(cell: Cell, row: dict[str, Any]) -> Picture | None:
    """Run a failed trial again and return a picture of its first contact. If there is no contact, return a
    picture of the end of the trial.

    Returns:
        None if the trial does not fail again (e.g. a processor time limit ended it) or cannot be drawn.
    """
    taken: list[Picture] = []
    try:
        varied = with_values(cell, row["values"])
        with varied.connect("sim", row["seed"]) as live:
            pictures = Pictures(live, lambda time, text, picture: taken.append(picture), stages=False)
            live.ctx.observers.append(pictures)
            succeeded = False
            with suppress(Exception):  # the exception may be the failure to show
                succeeded = run_task(varied, live, row["seed"], "sim")["success"]
            if not succeeded and not taken:
                taken.append(pictures.now())
    except Exception as error:  # the report is useful without the picture, too
        logger.warning("trial %d has no picture: %s", row["trial"], error)
        return None
    return None if succeeded else taken[0]
