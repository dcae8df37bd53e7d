"""Scores of predicted successes: each by its definition, and no object judged by what it taught."""

from __future__ import annotations

import numpy as np
import pytest

from armcell.cell.grasp_predictions import (
    area_under_curve,
    leave_one_out_curve,
    leave_one_out_mean,
    reliability,
    scores,
)

NAMES = np.repeat(["a", "b", "c", "d"], 5)


@pytest.fixture
def trials():
    rng = np.random.default_rng(1)
    epsilon = rng.uniform(0, 0.1, len(NAMES))
    return epsilon, (epsilon + rng.normal(0, 0.03, len(NAMES)) > 0.04).astype(float)


@pytest.mark.parametrize("name", ["a", "c"])
def test_what_is_fitted_has_not_seen_the_object_it_is_asked_about(trials, name):
    epsilon, happened = trials
    own = name == NAMES
    other = np.where(own, 1 - happened, happened)
    for fitted in (lambda y: leave_one_out_curve(NAMES, epsilon, y), lambda y: leave_one_out_mean(NAMES, y)):
        before, after = fitted(happened), fitted(other)
        np.testing.assert_allclose(before[own], after[own])
        assert np.abs(before - after)[~own].min() > 1e-3


def test_the_curve_rises_with_epsilon_where_successes_do(trials):
    epsilon, happened = trials
    curve = leave_one_out_curve(NAMES, epsilon, happened)
    own = NAMES == "a"
    assert np.all(np.diff(curve[own][np.argsort(epsilon[own])]) > 0)


def test_the_area_under_the_curve_counts_pairs():
    rng = np.random.default_rng(0)
    score, happened = rng.integers(0, 5, 60).astype(float), rng.integers(0, 2, 60).astype(float)
    good, bad = score[happened == 1], score[happened == 0]
    pairs = np.sign(good[:, None] - bad[None, :]) / 2 + 0.5
    assert area_under_curve(score, happened) == pytest.approx(pairs.mean())
    assert area_under_curve(score, np.ones(60)) is None


def test_each_trial_is_in_one_bin():
    p = np.array([0.0, 0.18, 0.3, 0.55, 0.88, 0.98, 0.98, 1.0])
    happened = np.array([0, 0, 1, 0, 1, 1, 0, 1.0])
    rows = reliability(p, happened)
    assert sum(r["n"] for r in rows) == len(p)
    assert all(r["from"] <= r["predicted"] <= r["to"] for r in rows)
    assert sum(r["n"] * r["happened"] for r in rows) == pytest.approx(happened.sum())
    assert rows[0]["n"] == 2 and rows[0]["predicted"] == pytest.approx(0.09)


def test_who_knows_scores_best(trials):
    epsilon, happened = trials
    sure = scores(NAMES.tolist(), happened.tolist(), epsilon.tolist(), (happened > 0.5).tolist())
    assert sure["brier_proof"] == 0.0 and sure["auc_proof"] == 1.0 and sure["log_loss_proof"] < 0.01
    assert 0 < sure["brier_epsilon"] < sure["brier_base_rate"]
    low, high = sure["brier_lead_interval"]
    assert 0 < low <= sure["brier_lead"] <= high
    assert sure["brier_lead"] == pytest.approx(sure["brier_epsilon"])
    wrong = scores(NAMES.tolist(), (1 - happened).tolist(), epsilon.tolist(), (happened > 0.5).tolist())
    assert wrong["brier_proof"] == 1.0 and wrong["brier_lead"] < 0
