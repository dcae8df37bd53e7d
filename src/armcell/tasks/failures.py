"""What became of each stage of a task: how often tried, what failed, what came nearest, and why."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass
class Tally:
    """One stage's candidates in one search."""

    path: tuple[str, ...]  # its name, after those of the containers it is in
    asked: int = 0  # drafts that it was to extend
    passed: int = 0  # drafts that it gave
    seconds: float = 0.0  # wall clock, with the stages in it
    reasons: dict[str, int] = field(default_factory=dict)  # counts, by the part that refused and why
    near_miss: tuple[str, str] | None = None  # candidate and reason; stages look at the best first

    @property
    def failed(self) -> int:
        return sum(self.reasons.values())

    def rejected(self, part: str, candidate: str, reason: str) -> None:
        """One candidate less; `part` is the stage, or a motion that it plans for a candidate."""
        short = reason_in_short(reason)
        key = short if part == self.path[-1] else f"{part}: {short}"
        self.reasons[key] = self.reasons.get(key, 0) + 1
        self.near_miss = self.near_miss or (candidate, reason)

    def add(self, other: Tally) -> None:
        """What became of more candidates, after these."""
        self.asked += other.asked
        self.passed += other.passed
        self.seconds += other.seconds
        for reason, count in other.reasons.items():
            self.reasons[reason] = self.reasons.get(reason, 0) + count
        self.near_miss = self.near_miss or other.near_miss

    def why(self, most: int = 2) -> str:
        """The commonest reasons, counted."""
        order = sorted(self.reasons.items(), key=lambda kv: -kv[1])
        more = f", {len(order) - most} others" if len(order) > most else ""
        return ", ".join(f"{n} x {reason}" for reason, n in order[:most]) + more

    def as_dict(self) -> dict[str, Any]:
        candidate, reason = self.near_miss or ("", "")
        return {
            "stage": "/".join(self.path), "asked": self.asked, "passed": self.passed, "failed": self.failed,
            "seconds": self.seconds, "reasons": dict(self.reasons), "near_miss": candidate, "why": reason,
        }  # fmt: skip


def reason_in_short(reason: str) -> str:
    """A reason without its particulars, to count by."""
    return reason.split(":")[0].split(" (")[0]


def stage_rows(tallies: Mapping[tuple[str, ...], Tally]) -> list[dict[str, Any]]:
    """Of every stage that was asked, in the order in which they came to be; for JSON."""
    return [tally.as_dict() for tally in tallies.values()]


def stage_table(rows: Iterable[Mapping[str, Any]]) -> str:
    """The rows as text: a line per stage, those in a container below it."""
    lines = [("stage", "tried", "gave", "failed", "time", "best near miss")]
    for row in rows:
        *outer, name = row["stage"].split("/")
        near = ": ".join(text for text in (row["near_miss"], row["why"]) if text)
        asked, passed, failed = (str(row[key]) for key in ("asked", "passed", "failed"))
        time = f"{row['seconds'] * 1000:.0f} ms"
        lines.append(("  " * len(outer) + name, asked, passed, failed, time, near))
    first, *widths = [max(len(line[i]) for line in lines) for i in range(5)]
    return "\n".join(
        "  ".join((line[0].ljust(first), *(c.rjust(w) for c, w in zip(line[1:5], widths)), line[5])).rstrip()
        for line in lines
    )
