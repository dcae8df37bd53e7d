"""Intervals, causes, effects and comparisons, against published numbers and against simulated campaigns."""

from __future__ import annotations

import numpy as np
import pytest

from armcell.campaigns.plots import parameter_plots
from armcell.campaigns.statistics import Proportion, causes, compare, drawn, effects, success, summary
from armcell.core import InputError


def rows(outcomes, **columns):
    nothing = {
        "near_failure": False,
        "randomized": {},
        "error_name": "X",
        "stage": "",
        "pair": "",
        "message": "m",
    }
    return [
        {
            "trial": i,
            "success": bool(good),
            "values": {k: v[i] for k, v in columns.items()},
            "message": "m",
            **nothing,
        }
        for i, good in enumerate(outcomes)
    ]


@pytest.mark.parametrize(
    ("count", "total", "wilson", "exact"),
    [  # Newcombe (1998), Statistics in Medicine 17, 857-872, table I: methods 3 and 5
        (81, 263, (0.2553, 0.3662), (0.2527, 0.3676)),
        (15, 148, (0.0624, 0.1605), (0.0578, 0.1617)),
        (0, 20, (0.0000, 0.1611), (0.0000, 0.1684)),
        (1, 29, (0.0061, 0.1718), (0.0009, 0.1776)),
    ],
)
def test_intervals_are_newcombe_s(count, total, wilson, exact):
    share = Proportion(count, total)
    assert share.wilson == pytest.approx(wilson, abs=6e-5)
    assert share.clopper_pearson == pytest.approx(exact, abs=6e-5)


def test_nothing_is_known_of_nothing():
    assert Proportion(0, 0).wilson == (0.0, 1.0) and success([]).total == 0
    assert summary([None, None]) is None and effects([]) == [] and causes([]) == []


def test_trials_put_near_failures_do_not_count():
    some = rows([1, 1, 0, 0])
    for row in some[2:]:
        row["near_failure"] = True
    assert success(some) == Proportion(2, 2)


def test_failures_with_one_cause_are_one_line():
    some = rows([0, 1, 0, 0])
    some[0] |= {"error_name": "A", "stage": "lift"}
    some[2] |= {"error_name": "B"}
    some[3] |= {"error_name": "A", "stage": "lift"}
    found = causes(some)
    assert [(c.code, c.stage, c.trials) for c in found] == [("A", "lift", (0, 3)), ("B", "", (2,))]


def test_the_parameter_that_matters_is_found_and_the_others_are_not():
    rng = np.random.default_rng(1)
    n = 400
    matters, not_, choice = rng.random(n), rng.random(n), rng.choice(["a", "b"], n)
    good = rng.random(n) < 0.2 + 0.7 * matters
    found = effects(rows(good, matters=matters.tolist(), none=not_.tolist(), choice=choice.tolist()))
    assert found[0].path == "matters" and found[0].p_value < 1e-9
    assert found[0].words == "high values succeed more often"
    assert all(effect.p_value > 0.05 for effect in found[1:])


def test_a_part_of_a_range_is_found_too():
    """Failures in the middle: neither high nor low values are better."""
    x = np.random.default_rng(3).uniform(-1, 1, 300)
    found = effects(rows(np.abs(x) > 0.3, x=x.tolist()))
    assert found[0].p_value < 1e-6 and found[0].words == "a part of its range fails more often"


@pytest.mark.parametrize(
    ("good", "words"),
    [
        (0, "too few successes to tell (0)"),
        (4, "too few successes to tell (4)"),
        (57, "too few failures to tell (3)"),
        (30, "low values succeed more often"),
    ],
)
def test_too_few_successes_or_failures_tell_nothing(good, words):
    """The lowest values succeed: with few successes, chance alone could have done it."""
    x = np.linspace(0, 1, 60)
    found = effects(rows(np.arange(60) < good, x=x.tolist(), kind=["a", "b"] * 30))
    assert {e.path: e.words for e in found}["x"] == words
    assert all(0 <= e.p_value <= 1 and (e.successes, e.failures) == (good, 60 - good) for e in found)
    assert effects(rows([1] * 60, x=x.tolist())) == []  # nothing failed: nothing to explain


def test_what_the_cell_draws_itself_is_looked_at_too():
    """A trial that made no cell has no draw; what is given stands for what is drawn."""
    y = np.random.default_rng(5).uniform(-1, 1, 100)
    some = rows(y > 0, given=[1.0] * 100)
    for row, at in zip(some, y, strict=True):
        row["randomized"] = {"box": {"dy": float(at)}}
    some += [{**row, "randomized": {}, "success": False} for row in rows([0] * 3, given=[1.0] * 3)]
    assert drawn(some[0]) == {"randomize.box.dy": y[0], "given": 1.0}
    found = effects(some)
    assert [e.path for e in found] == ["randomize.box.dy"] and found[0].p_value < 1e-9
    assert parameter_plots(some, ["randomize.box.dy", "given"])


@pytest.mark.long
def test_nothing_matters_in_nineteen_of_twenty():
    """With 5 parameters that do nothing, one of them is called an effect in about 5 % of campaigns."""
    rng = np.random.default_rng(2)
    alarms = 0
    for _ in range(200):
        columns = {f"p{k}": rng.random(60).tolist() for k in range(5)}
        alarms += any(e.p_value < 0.05 for e in effects(rows(rng.random(60) < 0.7, **columns)))
    assert alarms <= 20


def test_trials_put_near_a_failure_accuse_nobody():
    """Failures come of one parameter; the others were near their values only because sampling put them."""
    rng = np.random.default_rng(4)
    matters, chance = rng.random(100), rng.random(100)
    good = matters > 0.1
    guilty = np.flatnonzero(~good)[0]
    near_matters, near_chance = (c[guilty] + 0.02 * rng.standard_normal(100) for c in (matters, chance))
    some = rows(
        np.r_[good, near_matters > 0.1],
        matters=np.r_[matters, near_matters].tolist(), chance=np.r_[chance, near_chance].tolist(),
    )  # fmt: skip
    for row in some[100:]:
        row["near_failure"] = True
    found = {e.path: e.p_value for e in effects(some)}
    assert found["matters"] < 0.001 and found["chance"] > 0.05
    for row in some:
        row["near_failure"] = False  # as if all had been drawn independently
    assert {e.path: e.p_value for e in effects(some)}["chance"] < 0.001


def test_nothing_is_compared_with_nothing():
    with pytest.raises(InputError, match="second campaign has no finished trial"):
        compare(rows([1, 0]), [])


def test_two_campaigns():
    worse, better = rows([1] * 80 + [0] * 20), rows([1] * 98 + [0] * 2)
    found = compare(worse, better)
    assert found.words.startswith("better") and found.interval[0] < 0.18 < found.interval[1]
    # Newcombe (1998), Statistics in Medicine 17, 873-890, table II, method 10: 56/70 against 48/80
    found = compare(rows([1] * 48 + [0] * 32), rows([1] * 56 + [0] * 14))
    assert found.difference == pytest.approx(0.2) and found.interval == pytest.approx(
        (0.0524, 0.3339), abs=6e-5
    )
    assert compare(worse, worse).words.startswith("no difference shown")
