"""What `armcell doctor` says of one thing."""

from __future__ import annotations

from dataclasses import dataclass

OK, NO, NOTE = "ok", "no", "note"


@dataclass(frozen=True)
class Line:
    """One thing looked at. `verdict`: ok, no (with the cure), or note: not wrong, but good to know."""

    verdict: str
    check: str
    found: str
