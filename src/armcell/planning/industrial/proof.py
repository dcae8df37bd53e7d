"""The proof that a motion touches nothing, or where it does."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from armcell.collision.kernel.checker import KernelChecker
from armcell.core import Contact, ErrorCode, Outcome
from armcell.planning.industrial.curves import Curve
from armcell.planning.placed import Placed

Array = NDArray[np.float64]

SAGITTAS = (2e-4, 1e-5)
"""[rad or m] that the proven chords may be off the motion; the second where the first is too coarse."""

BETWEEN_POINTS = 1e-7  # [rad or m] that the interpolation between trajectory points may leave the curve
TOUCH_STEP = 0.005  # [rad or m] between the places among which the first contact is told
PADDING_STEP = 0.03  # [rad] between the places where the padding is looked at


def proven(checker: KernelChecker, curve: Curve, placed: Placed | None, what: str) -> Array | Outcome:
    """Points (k, n) of a motion that is proven free, padding included at samples; or what it touches."""
    points = np.empty((0, 0))
    certificate = None
    for sagitta in SAGITTAS:
        points, slack = curve.polyline(sagitta)
        certificate = checker.certify(points, slack + BETWEEN_POINTS, evidence=sagitta == SAGITTAS[-1])
        if certificate.free:
            break
    assert certificate is not None
    if not certificate.free:
        at, q = _first_touching(checker, points, certificate.at)
        contacts = checker.exact.contacts(q, padded=False) or [c for c in [certificate.contact] if c]
        return _touches(what, at, q, contacts, placed)
    for k, (a, b) in enumerate(pairwise(points)):
        if not checker.edge_is_free(a, b, PADDING_STEP):
            q, share = _first_padded(checker, a, b)
            return _touches(what, (k + share) / (len(points) - 1), q, checker.exact.contacts(q), placed)
    return points


def _between(points: Array, at: float) -> Array:
    place = at * (len(points) - 1)
    k = min(int(place), len(points) - 2)
    return points[k] + (place - k) * (points[k + 1] - points[k])


def _first_touching(checker: KernelChecker, points: Array, at: float) -> tuple[float, Array]:
    """The first place that touches, up to one that is known to: the proof does not go from front to end."""
    length = float(np.abs(np.diff(points, axis=0)).max(axis=1).sum())
    for share in np.linspace(0.0, at, max(int(np.ceil(length * at / TOUCH_STEP)), 1), endpoint=False):
        if checker.touches(q := _between(points, float(share))):
            return float(share), q
    return at, _between(points, at)


def _first_padded(checker: KernelChecker, a: Array, b: Array) -> tuple[Array, float]:
    count = max(int(np.ceil(np.max(np.abs(b - a)) / PADDING_STEP)), 1)
    for share in np.linspace(0.0, 1.0, count + 1):
        if not checker.is_free(a + share * (b - a)):
            return a + share * (b - a), float(share)
    return b, 1.0


def _touches(what: str, at: float, q: Array, contacts: list[Contact], placed: Placed | None) -> Outcome:
    where = ""
    if placed is not None:
        where = f", {placed.name} at (" + ", ".join(f"{v:.3f}" for v in placed.pose(q).translation) + ")"
    told = "; ".join(c.describe() for c in contacts[:3]) or "it cannot be proven free"
    evidence = {"contacts": contacts, "fraction": at, "positions": q}
    return Outcome(ErrorCode.INVALID_MOTION_PLAN, f"{what} at {at:.0%} of the way{where}: {told}", evidence)
