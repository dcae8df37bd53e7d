"""Statistics of campaigns: success rates, causes of failure, parameter effects, comparison."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from armcell.core import InputError

Row = Mapping[str, Any]

UNSIDED = 0.1  # maximum distance of the AUC from 0.5 at which no side of the range is better
FEWEST = 5  # least number of successes, and of failures, that shows an effect of a parameter
ALPHA = 0.05  # significance level; all intervals are 95 % intervals


@dataclass(frozen=True)
class Proportion:
    """Proportion `count` / `total` in the statistics of a campaign,
    with two kinds of 95 % confidence interval.
    """

    count: int
    total: int

    @property
    def value(self) -> float:
        return self.count / self.total if self.total else math.nan

    @property
    def wilson(self) -> tuple[float, float]:
        """Return the Wilson score interval of a proportion in the statistics of a campaign. On average, it
        contains the true rate with a probability of 95 %.

        Wilson (1927), J. Am. Stat. Assoc. 22.
        """
        return self._interval("wilson")

    @property
    def clopper_pearson(self) -> tuple[float, float]:
        """Return the exact (Clopper-Pearson) 95 % confidence interval of a proportion in the statistics of a
        campaign. It contains the true rate with a probability of at least 95 %.

        Clopper and Pearson (1934), Biometrika 26.
        """
        return self._interval("exact")

    def _interval(self, method: Literal["wilson", "exact"]) -> tuple[float, float]:
        if self.total == 0:
            return 0.0, 1.0
        from scipy import stats  # imported late: workers of campaigns need none of it

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


def without_adaptive_samples(rows: Sequence[Row]) -> list[Row]:
    """Return the result rows of a campaign without the trials that adaptive sampling placed near failures.
    Those trials would bias the statistics.
    """
    return [row for row in rows if not row["near_failure"]]


def success(rows: Sequence[Row]) -> Proportion:
    """Return the success rate of a campaign, counted over the trials that were drawn from the specified
    distributions.

    Trials placed near failures by adaptive sampling are excluded, because they would bias the rate.
    """
    fair = without_adaptive_samples(rows)
    return Proportion(sum(bool(row["success"]) for row in fair), len(fair))


@dataclass(frozen=True)
class Cause:
    """Group of failed trials in a campaign's statistics, with the same error code, stage and pair of
    bodies.
    """

    code: str
    stage: str
    pair: str
    trials: tuple[int, ...]
    message: str  # of the first trial


def causes(rows: Sequence[Row]) -> list[Cause]:
    """Group the failed trials of a campaign by error code, stage and pair of bodies, for the statistics.
    Return the groups, the most frequent one first.
    """
    found: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        if not row["success"]:
            found.setdefault((row["error_name"], row["stage"], row["pair"]), []).append(row)
    ranked = sorted(found.items(), key=lambda item: (-len(item[1]), item[0]))
    return [Cause(*key, tuple(r["trial"] for r in some), some[0]["message"]) for key, some in ranked]


@dataclass(frozen=True)
class Effect:
    """Effect of one campaign parameter on the success of trials, as estimated by statistical tests.

    Attributes:
        auc: for numeric parameters, the probability that a successful trial has a higher value than a failed
            trial; 0.5 means no influence. None for choices.
        p_value: probability of a difference at least this large if the parameter has no influence, with
            Holm's correction for the number of parameters. 1 if all trials failed.
        successes, failures: number of trials with the parameter that succeeded, and that failed.
    """

    path: str
    auc: float | None
    p_value: float
    successes: int
    failures: int

    @property
    def words(self) -> str:
        for count, name in ((self.successes, "successes"), (self.failures, "failures")):
            if count < FEWEST:
                return f"too few {name} to tell ({count})"
        if self.p_value >= ALPHA:
            return "no effect seen"
        if self.auc is None:
            return "some values fail more often than others"
        if abs(self.auc - 0.5) < UNSIDED:
            return "a part of its range fails more often"
        return "high values succeed more often" if self.auc > 0.5 else "low values succeed more often"


def drawn(row: Row) -> dict[str, Any]:
    """Return the values that a trial varied, for the statistics of a campaign: the campaign's parameters and
    the values that the cell's `randomize` drew. The keys are the values' paths in the cell file.

    A trial whose values gave an invalid cell has no `randomize` draws.
    """
    own = row["randomized"].items()
    return {f"randomize.{name}.{key}": v for name, d in own for key, v in d.items()} | dict(row["values"])


def effects(rows: Sequence[Row]) -> list[Effect]:
    """Return the effect of each varied campaign parameter on the success rate, with statistics.
    The largest effect comes first.

    The result is empty if all trials succeeded. Tests: for numbers Mann-Whitney (is one side of the range
    better?) and Kolmogorov-Smirnov (is any part of the range better?), for choices chi-squared. With fewer
    than 5 successes or failures, the words of the effect say that they are too few to tell. The tests need
    independent draws. Trials placed near failures are excluded, because they share all parameters
    of a failure, so every parameter would appear significant.
    """
    draws = [(drawn(row), bool(row["success"])) for row in without_adaptive_samples(rows)]
    from scipy import stats

    found = []
    for path in sorted({path for draw, _ in draws for path in draw}):
        values = [draw[path] for draw, _ in draws if path in draw]
        good = np.array([success for draw, success in draws if path in draw])
        counts = int(good.sum()), int((~good).sum())
        if good.all():
            continue
        if all(isinstance(v, int | float) and not isinstance(v, bool) for v in values):
            numbers = np.array(values, float)
            if np.ptp(numbers) == 0:
                continue
            if not good.any():
                found.append((path, None, 1.0, counts))
                continue
            higher = stats.mannwhitneyu(numbers[good], numbers[~good])
            other = stats.ks_2samp(numbers[good], numbers[~good])
            p = min(1.0, 2 * min(_p(higher), _p(other)))  # Bonferroni correction for two tests
            found.append((path, float(higher.statistic) / (good.sum() * (~good).sum()), p, counts))
            continue
        kinds = sorted({repr(v) for v in values})
        if len(kinds) < 2:
            continue
        by_kind = Counter((repr(v), bool(g)) for v, g in zip(values, good, strict=True))
        table = [[by_kind[kind, True], by_kind[kind, False]] for kind in kinds]
        p = _p(stats.chi2_contingency(table)) if good.any() else 1.0
        found.append((path, None, p, counts))
    found.sort(key=lambda effect: effect[2])
    corrected, least = [], 0.0
    for i, (path, auc, p, counts) in enumerate(found):  # Holm (1979), Scand. J. Stat. 6
        least = max(least, min(1.0, p * (len(found) - i)))
        corrected.append(Effect(path, auc, least, *counts))
    return corrected


@dataclass(frozen=True)
class Comparison:
    """Statistics that compare two campaigns: both success rates and their difference (second minus first).

    `interval` is Newcombe's 95 % interval from two Wilson intervals (1998), `p_value` is Fisher's exact test.
    """

    first: Proportion
    second: Proportion
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
    """Compare the success rates of two campaigns statistically.

    Raises:
        InputError: a campaign has no finished trial that counts.
    """
    from scipy import stats

    a, b = success(first), success(second)
    for name, share in (("first", a), ("second", b)):
        if not share.total:
            raise InputError(f"the {name} campaign has no finished trial", hint="go on with it by --resume")
    difference = b.value - a.value
    (la, ua), (lb, ub) = a.wilson, b.wilson
    interval = (
        difference - math.hypot(b.value - lb, ua - a.value),
        difference + math.hypot(ub - b.value, a.value - la),
    )
    table = [[a.count, a.total - a.count], [b.count, b.total - b.count]]
    return Comparison(a, b, difference, interval, _p(stats.fisher_exact(table)))


def summary(values: Sequence[float | None]) -> dict[str, float] | None:
    """Return the minimum, median, 95th percentile and maximum of measured values as statistics,
    or None if there are no values.
    """
    numbers = np.array([v for v in values if v is not None], float)
    if not len(numbers):
        return None
    low, middle, p95, high = np.percentile(numbers, [0, 50, 95, 100])
    return {"least": float(low), "median": float(middle), "p95": float(p95), "most": float(high)}


def _p(result: Any) -> float:
    """Return the p-value of a statistical test on the results of a campaign, given scipy's result object.

    The argument is typed Any because scipy creates its result classes at run time.
    """
    return float(result.pvalue)
