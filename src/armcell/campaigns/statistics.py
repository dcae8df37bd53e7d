"""Shares with intervals, what failures have in common, which parameter matters, campaigns compared."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy import stats

from armcell.core import InputError

Row = Mapping[str, Any]

UNSIDED = 0.1  # from an AUC of 0.5: neither side of the range is the better one
ALPHA = 0.05  # of all intervals: 95 %


@dataclass(frozen=True)
class Share:
    """`count` of `total`, with two 95 % intervals."""

    count: int
    total: int

    @property
    def value(self) -> float:
        return self.count / self.total if self.total else math.nan

    @property
    def wilson(self) -> tuple[float, float]:
        """Wilson's score interval: right on average. Wilson (1927), J. Am. Stat. Assoc. 22."""
        return self._interval("wilson")

    @property
    def clopper_pearson(self) -> tuple[float, float]:
        """The exact interval: never too narrow. Clopper and Pearson (1934), Biometrika 26."""
        return self._interval("exact")

    def _interval(self, method: Literal["wilson", "exact"]) -> tuple[float, float]:
        if self.total == 0:
            return 0.0, 1.0
        found = stats.binomtest(self.count, self.total).proportion_ci(1 - ALPHA, method)
        return float(found.low), float(found.high)

    def as_dict(self) -> dict[str, Any]:
        return {
            "count": self.count,
            "total": self.total,
            "share": self.value if self.total else None,
            "wilson": list(self.wilson),
            "clopper_pearson": list(self.clopper_pearson),
        }


def fairly_drawn(rows: Sequence[Row]) -> list[Row]:
    """Without the trials that adaptive sampling put near failures."""
    return [row for row in rows if not row["near_failure"]]


def success(rows: Sequence[Row]) -> Share:
    """Of the trials that were drawn as the campaign says: those put near failures would spoil the share."""
    fair = fairly_drawn(rows)
    return Share(sum(bool(row["success"]) for row in fair), len(fair))


@dataclass(frozen=True)
class Cause:
    """Failures with the same code, stage and pair of bodies, and the trials that had them."""

    code: str
    stage: str
    pair: str
    trials: tuple[int, ...]
    message: str  # of the first


def causes(rows: Sequence[Row]) -> list[Cause]:
    """What failed trials have in common, the most frequent first."""
    found: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        if not row["success"]:
            found.setdefault((row["error_name"], row["stage"], row["pair"]), []).append(row)
    ranked = sorted(found.items(), key=lambda item: (-len(item[1]), item[0]))
    return [Cause(*key, tuple(r["trial"] for r in some), some[0]["message"]) for key, some in ranked]


@dataclass(frozen=True)
class Effect:
    """How much a parameter matters for success.

    Attributes:
        auc: for numbers, the probability that a successful trial had a higher value than a failed one: 0.5
            says that it does not matter. None for choices.
        p_value: probability of so large a difference if it did not matter, corrected for the number of
            parameters looked at (Holm).
    """

    path: str
    auc: float | None
    p_value: float

    @property
    def words(self) -> str:
        if self.p_value >= ALPHA:
            return "no effect seen"
        if self.auc is None:
            return "some values fail more often than others"
        if abs(self.auc - 0.5) < UNSIDED:
            return "a part of its range fails more often"
        return "high values succeed more often" if self.auc > 0.5 else "low values succeed more often"


def drawn(row: Row) -> dict[str, Any]:
    """What was another in this trial than in others, by path: what was varied, and what the cell's
    `randomize` drew. (A trial that made no cell has no draw.)"""
    own = row["randomized"].items()
    return {f"randomize.{name}.{key}": v for name, d in own for key, v in d.items()} | dict(row["values"])


def effects(rows: Sequence[Row]) -> list[Effect]:
    """Every parameter that was drawn, the one that matters most first; empty where all trials went alike.

    For numbers Mann and Whitney's test (does one side of the range succeed more?) and Kolmogorov and
    Smirnov's (does any part of it?), for choices chi squared. They need trials that were drawn independently:
    those put near failures share all parameters of a failure, and would make each of them look guilty.
    """
    draws = [(drawn(row), bool(row["success"])) for row in fairly_drawn(rows)]
    found = []
    for path in sorted({path for draw, _ in draws for path in draw}):
        values = [draw[path] for draw, _ in draws if path in draw]
        good = np.array([success for draw, success in draws if path in draw])
        if good.all() or not good.any():
            continue
        if all(isinstance(v, int | float) and not isinstance(v, bool) for v in values):
            numbers = np.array(values, float)
            if np.ptp(numbers) == 0:
                continue
            higher = stats.mannwhitneyu(numbers[good], numbers[~good])
            other = stats.ks_2samp(numbers[good], numbers[~good])
            p = min(1.0, 2 * min(_p(higher), _p(other)))  # two looks at one question
            found.append((path, float(higher.statistic) / (good.sum() * (~good).sum()), p))
            continue
        kinds = sorted({repr(v) for v in values})
        if len(kinds) < 2:
            continue
        counts = Counter((repr(v), bool(g)) for v, g in zip(values, good, strict=True))
        table = [[counts[kind, True], counts[kind, False]] for kind in kinds]
        found.append((path, None, _p(stats.chi2_contingency(table))))
    found.sort(key=lambda effect: effect[2])
    corrected, least = [], 0.0
    for i, (path, auc, p) in enumerate(found):  # Holm (1979), Scand. J. Stat. 6
        least = max(least, min(1.0, p * (len(found) - i)))
        corrected.append(Effect(path, auc, least))
    return corrected


@dataclass(frozen=True)
class Comparison:
    """Two campaigns' success: the difference (second minus first), its 95 % interval (Newcombe's from two
    Wilson intervals, 1998) and Fisher's exact p-value."""

    first: Share
    second: Share
    difference: float
    interval: tuple[float, float]
    p_value: float

    @property
    def words(self) -> str:
        change = f"{self.difference:+.2%} (95 % interval {self.interval[0]:+.2%} to {self.interval[1]:+.2%})"
        if self.p_value >= ALPHA:
            return f"no difference shown: {change}, p = {self.p_value:.3g}"
        return f"{'better' if self.difference > 0 else 'worse'}: {change}, p = {self.p_value:.3g}"


def compare(first: Sequence[Row], second: Sequence[Row]) -> Comparison:
    """Whether the second campaign succeeds more often than the first.

    Raises:
        InputError: a campaign without a trial that counts.
    """
    a, b = success(first), success(second)
    for name, share in (("first", a), ("second", b)):
        if not share.total:
            raise InputError(f"the {name} campaign has no finished trial", cure="go on with it by --resume")
    difference = b.value - a.value
    (la, ua), (lb, ub) = a.wilson, b.wilson
    interval = (
        difference - math.hypot(b.value - lb, ua - a.value),
        difference + math.hypot(ub - b.value, a.value - la),
    )
    table = [[a.count, a.total - a.count], [b.count, b.total - b.count]]
    return Comparison(a, b, difference, interval, _p(stats.fisher_exact(table)))


def summary(values: Sequence[float | None]) -> dict[str, float] | None:
    """Median, 95th percentile and extremes of what was measured; None if nothing was."""
    numbers = np.array([v for v in values if v is not None], float)
    if not len(numbers):
        return None
    low, middle, p95, high = np.percentile(numbers, [0, 50, 95, 100])
    return {"least": float(low), "median": float(middle), "p95": float(p95), "most": float(high)}


def _p(result: Any) -> float:
    """The p-value of a test; Any, as scipy's results are classes made at run time."""
    return float(result.pvalue)
