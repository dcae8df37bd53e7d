"""A result line of `armcell doctor`."""

from __future__ import annotations

from dataclasses import dataclass

OK, NO, NOTE = "ok", "no", "note"


@dataclass(frozen=True)
class Finding:
    """Line with the result of one check by `armcell doctor`.

    Attributes:
        verdict: "ok", "no" (fault) or "note" (information).
        check: name of the check.
        found: the result in words; for a fault, with the hint.
    """

    verdict: str
    check: str
    found: str
