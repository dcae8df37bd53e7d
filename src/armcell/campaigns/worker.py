"""Worker process that runs trials: one JSON line in, one JSON line out.

`processes` starts it, and it ends when its input ends. It ignores SIGINT and SIGTERM: the campaign's process
decides when it ends.
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
from armcell.cell.value_overrides import with_values
from armcell.core import InputError


def cell_of(spec: CampaignSpec) -> Cell:
    return with_values(load(spec.cell), spec.values)


def _lines(source: TextIO) -> queue.Queue[dict[str, Any]]:
    """Read JSON lines into a queue in a worker process of a campaign.
    The process exits as soon as the input ends.

    No process waits for the running trial after the input has ended.
    """
    found: queue.Queue[dict[str, Any]] = queue.Queue()

    def read() -> None:
        for line in source:
            found.put(json.loads(line))
        os._exit(0)

    threading.Thread(target=read, name="armcell-worker-input", daemon=True).start()
    return found


def main() -> None:
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # keep library output out of the answers
    logging.getLogger("armcell").setLevel(logging.ERROR)  # the parent process already logs
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
