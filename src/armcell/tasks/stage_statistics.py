"""Statistics of a task's stages: attempts, failures with reasons, and nearest misses."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass
class StageStatistics:
    """Statistics of the candidates that one stage evaluates in one search."""

    path: tuple[str, ...]  # names of the containers, then of the stage
    asked: int = 0  # number of solutions to extend
    passed: int = 0  # number of proposed solutions
    seconds: float = 0.0  # wall clock, including contained stages
    reasons: dict[str, int] = field(default_factory=dict)  # counts by rejecting part and reason
    near_miss: tuple[str, str] | None = None  # first rejected (candidate, reason); stages try the best first

    @property
    def failed(self) -> int:
        return sum(self.reasons.values())

    def add_rejection(self, part: str, candidate: str, reason: str) -> None:
        """Count a candidate that a stage has rejected. `part` is the name of the stage, or of the motion that
        failed for this candidate.
        """
        short = reason_in_short(reason)
        key = short if part == self.path[-1] else f"{part}: {short}"
        self.reasons[key] = self.reasons.get(key, 0) + 1
        self.near_miss = self.near_miss or (candidate, reason)

    def add(self, other: StageStatistics) -> None:
        """Merge the statistics `other`, which a search thread has collected for this stage, into these
        statistics.

        The candidates in `other` come later in the search. An existing near miss is therefore kept.
        """
        self.asked += other.asked
        self.passed += other.passed
        self.seconds += other.seconds
        for reason, count in other.reasons.items():
            self.reasons[reason] = self.reasons.get(reason, 0) + count
        self.near_miss = self.near_miss or other.near_miss

    def why(self, most: int = 2) -> str:
        """Return the most frequent reasons why a stage rejected candidates, with their counts."""
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
    """Return the general reason in a stage's rejection message, without the details after a colon or in
    parentheses, so that equal reasons can be counted.
    """
    return reason.split(":")[0].split(" (")[0]


def stage_rows(tallies: Mapping[tuple[str, ...], StageStatistics]) -> list[dict[str, Any]]:
    """Return the statistics of all evaluated stages as rows for JSON,
    in the order of their first evaluation.
    """
    return [tally.as_dict() for tally in tallies.values()]


def stage_table(rows: Iterable[Mapping[str, Any]]) -> str:
    """Format the statistics of stages as a text table,
    in which the inner stages of a container are indented.
    """
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
