"""A process that runs trials: one JSON line in, one out. Started by `processes`; ends when its input does.

SIGINT and SIGTERM do not reach it: the campaign's process decides when it ends.
"""

from __future__ import annotations

import json
import logging
import os
import queue
import sys
import threading
from typing import Any, TextIO

from armcell.campaigns.spec import CampaignSpec
from armcell.campaigns.trial import Trial, run_trial
from armcell.cell import Cell, load
from armcell.cell.values import with_values
from armcell.core import InputError


def cell_of(spec: CampaignSpec) -> Cell:
    return with_values(load(spec.cell), spec.values)


def _lines(source: TextIO) -> queue.Queue[dict[str, Any]]:
    """Lines as they come. At the end of input the process ends at once: nobody waits for its trial."""
    found: queue.Queue[dict[str, Any]] = queue.Queue()

    def read() -> None:
        for line in source:
            found.put(json.loads(line))
        os._exit(0)

    threading.Thread(target=read, name="armcell-worker-input", daemon=True).start()
    return found


def main() -> None:
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # whatever a library prints is no answer
    logging.getLogger("armcell").setLevel(logging.ERROR)  # once per campaign is enough
    asked = _lines(sys.stdin)

    def answer(row: dict[str, Any]) -> None:
        answers.write(json.dumps(row, allow_nan=False) + "\n")
        answers.flush()

    try:
        cell = cell_of(CampaignSpec(**asked.get()))
    except InputError as error:
        return answer({"cell": str(error)})
    answer({"ready": True})
    while True:
        answer(run_trial(cell, Trial(**asked.get())))


if __name__ == "__main__":
    main()
