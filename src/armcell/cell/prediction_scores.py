"""Scores of predicted grasp success: Brier score, log loss, AUC and reliability.

The proof's probability P is scored directly. The grasp quality epsilon is not a probability, so a logistic
curve maps it to one. This curve and the base rate (share of successes) are fitted to all other objects,
because the trials of one object are correlated.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

EDGES = (0.0, 0.3, 0.6, 0.8, 0.9, 0.95, 1.0)  # edges of the bins of P in the reliability table
LEAST = 1e-3  # the log loss clips probabilities to [LEAST, 1 - LEAST]
RIDGE = 0.05  # ridge penalty: keeps the fit finite if epsilon separates successes from failures
RESAMPLED = 2000  # bootstrap resamples of the objects for the interval of the lead


def scores(
    objects: Sequence[str], probability: Sequence[float], epsilon: Sequence[float], success: Sequence[bool]
) -> dict[str, Any]:
    """Compare the scores of three predictors of grasp success: P from grasp proofs,
    the quality epsilon alone, and the base rate.

    `brier_lead` is the Brier score of epsilon minus that of P, and `brier_lead_interval` its 95 % bootstrap
    interval over objects. An area under the curve is None without successes or without failures.

    Args:
        objects, probability, epsilon, success: one value per trial.
    """
    names, p, happened = np.array(objects), np.array(probability, float), np.array(success, float)
    means = leave_one_out_mean(names, happened)
    curve = leave_one_out_curve(names, np.array(epsilon, float), happened)
    found: dict[str, Any] = {"predictions": len(p), "successes_of_predictions": int(happened.sum())}
    for name, q in (("proof", p), ("epsilon", curve), ("base_rate", means)):
        found[f"brier_{name}"] = float(np.mean((q - happened) ** 2))
        clipped = np.clip(q, LEAST, 1 - LEAST)
        found[f"log_loss_{name}"] = float(
            -np.mean(happened * np.log(clipped) + (1 - happened) * np.log(1 - clipped))
        )
    found["auc_proof"] = area_under_curve(p, happened)
    found["auc_epsilon"] = area_under_curve(np.array(epsilon, float), happened)
    lead = (curve - happened) ** 2 - (p - happened) ** 2
    found["brier_lead"] = float(lead.mean())
    found["brier_lead_interval"] = _interval(names, lead)
    found["reliability"] = reliability(p, happened)
    return found


def reliability(p: Array, happened: Array) -> list[dict[str, float]]:
    """Group predicted success probabilities into bins. Return the limits, count, mean prediction and observed
    success rate of each nonempty bin.
    """
    rows = []
    bins = np.clip(np.searchsorted(EDGES, p, side="right") - 1, 0, len(EDGES) - 2)
    for k in np.unique(bins):
        inside = bins == k
        rows.append(
            {
                "from": EDGES[k], "to": EDGES[k + 1], "n": int(inside.sum()),
                "predicted": float(p[inside].mean()), "happened": float(happened[inside].mean()),
            }
        )  # fmt: skip
    return rows


def area_under_curve(score: Array, happened: Array) -> float | None:
    """Return the AUC of predictions: the probability that a success has a higher score than a failure.

    Ties count half. The result is None without successes or without failures.
    """
    good, bad = score[happened > 0.5], score[happened <= 0.5]
    if not len(good) or not len(bad):
        return None
    less = np.searchsorted(np.sort(bad), good, side="left")
    upto = np.searchsorted(np.sort(bad), good, side="right")
    return float((less + upto).mean() / (2 * len(bad)))


def leave_one_out_mean(objects: NDArray[np.str_], happened: Array) -> Array:
    """Return the base-rate prediction of each trial: the success rate of all other objects, or 0.5 if there
    are none.
    """
    found = np.full(len(happened), 0.5)
    for name in np.unique(objects):
        own = objects == name
        if not own.all():
            found[own] = happened[~own].mean()
    return found


def leave_one_out_curve(objects: NDArray[np.str_], epsilon: Array, happened: Array) -> Array:
    """Predict P(success) of each trial from epsilon alone.
    The logistic curve is fitted to the trials of all other objects.
    """
    from scipy.optimize import minimize

    x = (epsilon - epsilon.mean()) / max(float(epsilon.std()), 1e-12)

    def loss(w: Array, keep: NDArray[np.bool_]) -> float:
        z = w[0] + w[1] * x[keep]
        return float(np.sum(np.logaddexp(0.0, z) - happened[keep] * z) + RIDGE * w @ w)

    found = np.empty(len(x))
    for name in np.unique(objects):
        own = objects == name
        w = minimize(loss, np.zeros(2), args=(~own,)).x
        found[own] = 1 / (1 + np.exp(-(w[0] + w[1] * x[own])))
    return found


def _interval(objects: NDArray[np.str_], lead: Array) -> tuple[float, float]:
    """Return the 95 % bootstrap interval for the mean lead of one prediction score over another.
    Objects are resampled.

    Each resampled object keeps all its trials.
    """
    names, index = np.unique(objects, return_inverse=True)
    total, count = np.bincount(index, lead), np.bincount(index)
    drawn = np.random.default_rng(0).integers(len(names), size=(RESAMPLED, len(names)))
    means = total[drawn].sum(1) / count[drawn].sum(1)
    low, high = np.quantile(means, (0.025, 0.975))
    return float(low), float(high)
