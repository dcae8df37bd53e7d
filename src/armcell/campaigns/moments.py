"""Pictures of trials at the moment they failed: they are run again, as the same trial gives the same."""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from armcell.campaigns.statistics import causes
from armcell.campaigns.store import Store, write_whole
from armcell.cell import Cell, load, run_task
from armcell.cell.pictures import Picture, Pictures
from armcell.cell.values import with_values
from armcell.records import html

logger = logging.getLogger(__name__)

MOST = 12  # pictures of a campaign
LONGEST = 60.0  # [s] a trial that took longer is not run again for its picture
NO_RUN = ("CRASHED", "TRIAL_TIMED_OUT", "INVALID_CELL")  # of trials that came to no end of their own


def picture_file(folder: Path, number: int) -> Path:
    """Where the picture of a trial is, if there is one."""
    return folder / "pictures" / f"trial_{number}.png"


def take_pictures(store: Store, tell: Callable[[int, int], None] = lambda done, of: None) -> None:
    """Of the first failure of each cause, then of others, as far as they are not there yet.

    Args:
        tell: called with how many are done, and of how many.
    Raises:
        InputError: the folder cannot be written to, or the disk is full.
    """
    wanted = _wanted(store)
    if not wanted:
        return
    cell = with_values(load(store.spec.cell), store.spec.values)
    for done, row in enumerate(wanted):
        tell(done, len(wanted))
        file = picture_file(store.folder, row["trial"])
        if not file.exists() and (picture := moment(cell, row)) is not None:
            with suppress(OSError):  # then writing says so
                file.parent.mkdir(exist_ok=True)
            write_whole(file, html.picture_png(picture))
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


def moment(cell: Cell, row: dict[str, Any]) -> Picture | None:
    """What a failed trial looked like when something first touched, else when it ended.

    Returns:
        None where it does not fail again, as where a limit on processor time has ended it, or where nothing
        can be drawn.
    """
    taken: list[Picture] = []
    try:
        varied = with_values(cell, row["values"])
        with varied.connect("sim", row["seed"]) as live:
            pictures = Pictures(live, lambda time, text, picture: taken.append(picture), stages=False)
            live.ctx.observers.append(pictures)
            succeeded = False
            with suppress(Exception):  # a defect may be the failure that the picture is of
                succeeded = run_task(varied, live, row["seed"], "sim")["success"]
            if not succeeded and not taken:
                taken.append(pictures.now())
    except Exception as error:  # a report without a picture is better than none
        logger.warning("trial %d has no picture: %s", row["trial"], error)
        return None
    return None if succeeded else taken[0]
